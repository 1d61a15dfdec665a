"""Clips that are damaged are named, and frames that were tracked wrongly are left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, FileMissing, MotionInvalid, NonFiniteData
from solver_backend.geometry.rotations import exp_so3
from solver_backend.training.data.corpus import build_corpus
from solver_backend.training.data.retarget import body_rotations, read_clip
from solver_backend.training.data.skeleton_maps import MAPS
from solver_backend.training.data.sources.clips import Clip, load_clips, without_faults
from solver_backend.training.engine.accuracy import accuracy_by_source
from tests.support.random_poses import poses


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
    with pytest.raises(MotionInvalid, match="no known skeleton.*mb2"):
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
