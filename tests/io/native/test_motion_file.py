"""Motion files come back as they were written, and are AMASS to other tools."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged, MotionInvalid, OutputExists
from solver_backend.exchange.npz import read_npz, write_npz
from solver_backend.io.native.motion_file import read_motion, write_motion
from tests.support.scenes import small_motion


@pytest.mark.parametrize("optional", [True, False])
@pytest.mark.parametrize("frames", [1, 6])
def test_round_trip(tmp_path: Path, frames: int, optional: bool) -> None:
    motion = small_motion(frames, optional)
    back = read_motion(write_motion(tmp_path / "m.npz", motion))
    for field in fields(motion):
        if field.name == "provenance":
            continue
        expected, found = getattr(motion, field.name), getattr(back, field.name)
        assert (expected is None) == (found is None), field.name
        if isinstance(expected, np.ndarray):
            np.testing.assert_array_equal(found, expected, err_msg=field.name)
        else:
            assert found == expected
    assert back.provenance == {"version": "0.1", "settings": {"window": 20}, "mean": 1.5, "worst": None}


def test_optional_arrays_are_left_out(tmp_path: Path) -> None:
    motion = replace(small_motion(optional=False), body_pose=np.zeros((6, 69)))
    assert set(read_npz(write_motion(tmp_path / "m.npz", motion))) == {
        "format", "version", "poses", "trans", "betas", "mocap_framerate", "gender", "body", "joints", "provenance",
    }  # fmt: skip


def test_reads_as_amass(tmp_path: Path) -> None:
    motion = small_motion()
    with np.load(write_motion(tmp_path / "m.npz", motion), allow_pickle=False) as data:
        assert data["poses"].shape == (6, 156)
        assert str(data["gender"]) == "neutral"
        np.testing.assert_array_equal(data["poses"][:, :3], motion.global_orient)
        np.testing.assert_array_equal(data["poses"][:, 3:66], motion.body_pose[:, :63])
        assert not data["poses"][:, 66:].any()
        np.testing.assert_array_equal(data["trans"], motion.transl)
        assert float(data["mocap_framerate"]) == 59.94
        assert data["betas"].shape == (10,)


def test_no_overwriting(tmp_path: Path) -> None:
    write_motion(tmp_path / "m.npz", small_motion())
    with pytest.raises(OutputExists):
        write_motion(tmp_path / "m.npz", small_motion(2))
    assert read_motion(tmp_path / "m.npz").num_frames == 6
    assert read_motion(write_motion(tmp_path / "m.npz", small_motion(2), overwrite=True)).num_frames == 2


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"format": None}, FileDamaged, "is AMASS.*no joint positions"),
        ({"trans": np.zeros((5, 3))}, FileDamaged, r"'trans' is float64 of shape \(5, 3\).*\(6, 3\)"),
        ({"joints": None}, FileDamaged, "lacks 'joints'"),
        ({"provenance": np.array("{")}, FileDamaged, "provenance is not JSON"),
        ({"provenance": np.array("[]")}, FileDamaged, "not a JSON object"),
        ({"trans": np.full((6, 3), np.nan)}, MotionInvalid, "transl holds NaN"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, changes: dict, error: type[Exception], text: str) -> None:
    arrays = {**read_npz(write_motion(tmp_path / "good.npz", small_motion())), **changes}
    write_npz(tmp_path / "bad.npz", {k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(error, match=text):
        read_motion(tmp_path / "bad.npz")
