"""The corpus: near-repeats, the split by subject, who moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileMissing
from tests.support.random_poses import poses
from tests.support.swaying_people import swaying
from training.data.corpus import HELD_OUT, absent_subjects, build_corpus, distinct_poses, split_corpus
from training.data.sources.clips import Clip, load_clips


def test_distinct_poses_cover_all() -> None:
    x = np.random.default_rng(2).normal(size=(500, 3))
    kept = distinct_poses(x, 0.5, block=64)
    distance = np.linalg.norm(x[:, None] - x[kept][None], axis=-1)
    assert (distance.min(axis=1) <= 0.5).all()
    between = distance[kept] + 9 * np.eye(len(kept))
    assert between.min() > 0.5 and len(kept) < 400


def test_split_by_subject_leaves_out_renamed_takes() -> None:
    held = poses(40, seed=3).astype(np.float32)
    other = poses(40, seed=4).astype(np.float32)
    clips = [
        Clip("a", "08", held),
        Clip("b", "unknown", held[10:30]),
        Clip("c", "unknown", other),
        Clip("d", "02", held),
    ]
    training, validation = split_corpus(clips)
    assert training.names == ("c", "d") and validation.names == ("a",)
    np.testing.assert_array_equal(training.clip_start, np.repeat([0, 40], 40))
    np.testing.assert_array_equal(training.clip_end, np.repeat([40, 80], 40))


def test_recordings_without_a_held_out_subject_are_named() -> None:
    clips = [Clip("a", "08", poses(4, seed=3).astype(np.float32)), Clip("b", "02", poses(4, seed=4).astype(np.float32))]
    assert absent_subjects(clips) == ("03", "13", "60_61", "ui_prmd_s07", "ui_prmd_s08")
    assert absent_subjects(clips, frozenset({"08"})) == ()
    with pytest.raises(FileMissing, match=r"none of the validation subjects \(03, 08, .*ui_prmd"):
        split_corpus(clips[1:])
    with pytest.raises(FileMissing, match="only validation subjects: 08"):
        split_corpus(clips[:1])


def test_keyed_clips_are_people_of_their_own_and_the_unknown_one() -> None:
    rotations = swaying(0).rotations
    names = ("keyed/roll", "keyed/sit", "expmap/a", "expmap/b", "mb2/02_01", "mb2/02_02")
    who = ("keyed", "keyed", "unknown", "unknown", "02", "02")
    parts = np.array_split(rotations, len(names))
    corpus = build_corpus([Clip(n, s, part) for n, s, part in zip(names, who, parts, strict=True)])
    firsts = corpus.people[np.unique(corpus.clip_start)]
    assert firsts[2] == firsts[3] and firsts[4] == firsts[5] and len(set(firsts.tolist())) == 4


@pytest.mark.shared
def test_validation_subjects_are_unseen(shared_data: Path, tmp_path: Path) -> None:
    folder = tmp_path / "motion_cmu" / "mb2"
    folder.mkdir(parents=True)
    for name in ("02_01", "08_01", "13_29"):
        (folder / f"{name}.npz").symlink_to(shared_data / "motion_cmu" / "mb2" / f"{name}.npz")
    training, validation = split_corpus(load_clips(tmp_path))
    assert training.names == ("mb2/02_01",) and {n[4:6] for n in validation.names} <= HELD_OUT
    assert 0 < len(training.distinct) <= training.num_frames
    assert build_corpus([Clip("a", "02", training.rotations)]).num_frames == training.num_frames
