"""Clips that are damaged are named, and frames that were tracked wrongly are left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, MotionInvalid, NonFiniteData
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.recorded_clip import MAPS, body_rotations
from tests.support.random_poses import poses
from training.data.corpus import HELD_OUT, SIMPLIFIED_EVERY, build_corpus, split_corpus
from training.data.sources.clips import Clip, load_clips, load_far_clips, read_clip, subject_of, without_faults
from training.engine.accuracy import accuracy_by_source


def test_bad_clips_are_named(tmp_path: Path) -> None:
    names = np.array(MAPS[0].joints)
    fields = {
        "names": names, "parents": np.arange(-1, 21), "offsets": np.zeros((22, 3)), "rotvec": np.zeros((2, 22, 3)),
        "root": np.zeros((2, 3)), "fps": 60.0,
    }  # fmt: skip
    path = tmp_path / "clip.npz"
    with pytest.raises(FileMissing, match="clip.npz"):
        read_clip(path)
    path.write_bytes(b"not an archive")
    with pytest.raises(FileDamaged, match="cannot be read"):
        read_clip(path)
    np.savez(path, **{k: v for k, v in fields.items() if k != "fps"})
    with pytest.raises(FileDamaged, match="lacks fps"):
        read_clip(path)
    np.savez(path, **(fields | {"rotvec": np.full((2, 22, 3), np.nan)}))
    with pytest.raises(NonFiniteData, match="not a number"):
        read_clip(path)
    np.savez(path, **(fields | {"names": np.array([f"bone{i}" for i in range(22)])}))
    with pytest.raises(MotionInvalid, match="not match a known skeleton.*mb2"):
        body_rotations(read_clip(path))
    with pytest.raises(FileMissing, match="No training clips"):
        load_clips(tmp_path)


def test_stretches_with_faults_are_left_out() -> None:
    R = poses(30, scale=0.1).astype(np.float32)
    R[10:13, 3] = exp_so3(np.array([-1.5, 0.0, 0.0]))
    R[28, 3] = exp_so3(np.array([-1.5, 0.0, 0.0]))
    pieces = without_faults(Clip("mb2/x", "02", R))
    assert [len(p.rotations) for p in pieces] == [10, 15]
    np.testing.assert_array_equal(pieces[1].rotations, R[13:28])
    corpus = build_corpus(pieces)
    assert set(corpus.sources.tolist()) == {"mb2"} and len(corpus.sources) == 25
    figures = accuracy_by_source(corpus, lambda rotations: rotations)
    assert figures["mb2"]["mpjpe_mm"] == 0.0 and figures["mb2"]["poses"] == len(corpus.distinct)


@pytest.mark.parametrize(
    ("path", "subject"),
    [
        ("mb2/13_29.npz", "13"), ("asfamc/135_03.npz", "135"), ("jump/139_16.npz", "139"), ("amc/14_20.amc.gz", "14"),
        ("segments/walk_39_01_1.npz", "39"), ("far/indian_04.npz", "unknown"), ("daz/salsa_07.npz", "60_61"),
        ("daz/martial_03.npz", "135"), ("expmap/train_walking_13.npz", "unknown"), ("mb2/Run_1.npz", "unknown"),
        ("asfamc/gsimchoni_zombie.npz", "unknown"), ("max/131_01.npz", "131"),
    ],
)  # fmt: skip
def test_subjects_are_told_from_files(path: str, subject: str) -> None:
    assert subject_of(Path(path)) == subject


def _store(folder: Path, name: str, frames: int, **more: np.ndarray) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    joints = next(m for m in MAPS if m.family == "mb2").joints
    rotvec = 0.02 * np.random.default_rng(frames).standard_normal((frames, 22, 3))
    parents = np.array([-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19])
    fields = {"rotvec": rotvec, "root": np.zeros((frames, 3)), "offsets": np.zeros((22, 3)), "fps": 30.0} | more
    np.savez(folder / f"{name}.npz", names=np.array(joints), parents=parents, **fields)


def test_a_take_counts_once_and_far_motions_are_kept_apart(tmp_path: Path) -> None:
    cmu = tmp_path / "motion_cmu"
    for folder, name, frames in (
        ("mb2", "01_01", 20), ("asfamc", "01_01", 30), ("daz_more", "01_01", 40), ("mb2", "01_02", 21),
        ("mb2", "Run_1", 22), ("expmap", "Run_1", 23), ("far", "indian_04", 24), ("daz_more", "03_01", 25),
    ):  # fmt: skip
        _store(cmu / folder, name, frames)
    clips = {clip.name: len(clip.rotations) for clip in load_clips(tmp_path)}
    assert clips == {"asfamc/01_01": 30, "mb2/01_02": 21, "mb2/Run_1": 22, "expmap/Run_1": 23, "daz_more/03_01": 25}
    assert [(clip.name, len(clip.rotations)) for clip in load_far_clips(tmp_path)] == [("far/indian_04", 24)]
    training, validation = split_corpus(load_clips(tmp_path))
    assert validation.names == ("daz_more/03_01",) and set(validation.subjects) <= HELD_OUT
    assert not any(name.startswith("far/") for name in training.names)
    assert load_far_clips(tmp_path / "nothing") == []


def test_roots_in_full_precision_stand_for_the_rounded_ones(tmp_path: Path) -> None:
    root = np.random.default_rng(1).standard_normal((9, 3))
    _store(tmp_path, "plain", 9)
    _store(tmp_path, "precise", 9, root_rotvec=root)
    np.testing.assert_array_equal(read_clip(tmp_path / "precise.npz").rotvec[:, 0], root)
    np.testing.assert_array_equal(
        read_clip(tmp_path / "precise.npz").rotvec[:, 1:], read_clip(tmp_path / "plain.npz").rotvec[:, 1:]
    )


def test_of_a_simplified_skeleton_few_poses_count() -> None:
    rotations = poses(40, scale=0.3).astype(np.float32)
    whole = build_corpus([Clip("mb2/01_01", "01", rotations)])
    few = build_corpus([Clip("jump/88_06", "88", rotations)])
    assert len(few.distinct) == len(whole.distinct) // SIMPLIFIED_EVERY and few.num_frames == whole.num_frames
