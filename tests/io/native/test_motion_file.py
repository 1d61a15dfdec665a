"""Motion files come back as they were written, and are AMASS to other tools."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange.body_layout import SMPL, BodyLayout
from solver_backend.exchange.errors import FileDamaged, MotionInvalid, OutputExists
from solver_backend.exchange.motion_file import read_motion as shown_motion
from solver_backend.exchange.npz import read_npz, write_npz
from solver_backend.fitters.measurements.markers import measure_motion
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.types import Motion
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
        ({"joints": None}, FileDamaged, "does not contain 'joints'"),
        ({"provenance": np.array("{")}, FileDamaged, "provenance is not JSON"),
        ({"provenance": np.array("[]")}, FileDamaged, "not a JSON object"),
        ({"provenance": np.array('{"resolved": 1.5}')}, FileDamaged, "'resolved' has an unexpected type"),
        ({"provenance": np.array('{"edits": ["x"]}')}, FileDamaged, "'edits' has an unexpected type"),
        ({"provenance": np.array('{"settings": []}')}, FileDamaged, "'settings' has an unexpected type"),
        ({"trans": np.full((6, 3), np.nan)}, MotionInvalid, "transl contains NaN"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, changes: dict, error: type[Exception], text: str) -> None:
    arrays = {**read_npz(write_motion(tmp_path / "good.npz", small_motion())), **changes}
    write_npz(tmp_path / "bad.npz", {k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(error, match=text):
        read_motion(tmp_path / "bad.npz")


LONG_TAIL = BodyLayout("tailed", ("hips", "spine", "tail1", "tail2"), (-1, 0, 0, 2), ("trunk", "trunk", "tail", "tail"))


def tailed_motion(frames: int = 5) -> Motion:
    rng = np.random.default_rng(3)
    return Motion(
        betas=np.zeros(10), global_orient=rng.normal(size=(frames, 3)), body_pose=rng.normal(size=(frames, 9)),
        transl=rng.normal(size=(frames, 3)), fps=60.0, body="dragon", joints=rng.normal(size=(frames, 4, 3)),
        body_layout=LONG_TAIL, joint_sigma=np.full((frames, 4), 0.01),
    )  # fmt: skip


def test_a_motion_of_another_layout_is_as_wide_as_it_and_comes_back(tmp_path):
    motion = tailed_motion()
    found = read_motion(write_motion(tmp_path / "take.npz", motion))
    assert found.body_layout == LONG_TAIL
    for name in ("global_orient", "body_pose", "joints", "joint_sigma"):
        np.testing.assert_allclose(getattr(found, name), getattr(motion, name), atol=1e-6)


def test_a_motion_of_another_layout_is_refused_where_smpl_is_expected_by_both_names(tmp_path):
    path = write_motion(tmp_path / "take.npz", tailed_motion())
    with pytest.raises(MotionInvalid, match=r"layout tailed \(4 joints\), but SMPL \(24 joints\) is expected"):
        shown_motion(path)
    with pytest.raises(MotionInvalid, match=r"layout tailed \(4 joints\), but SMPL \(24 joints\)"):
        measure_motion(load_body(), read_motion(path), [], np.zeros(1))
    assert shown_motion(path, LONG_TAIL).rotvec.shape == (5, 4, 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_parents": np.array([-1, 3, 0, 2])}, "not a tree"),
        ({"joint_parents": np.array([-1.0, np.nan, 0, 2])}, "are not a valid layout|not a layout"),
        ({"joint_names": np.array(["hips", "spine", "tail1"])}, "are not a valid layout|not a layout"),
        ({"poses": np.zeros((5, 156), np.float32)}, "of the layout tailed"),
    ],
)
def test_a_damaged_layout_is_refused_by_name(tmp_path, change, message):
    path = write_motion(tmp_path / "take.npz", tailed_motion())
    with np.load(path) as data:
        np.savez(path, **{**data, **change})
    with pytest.raises(MotionInvalid, match=message):
        shown_motion(path, LONG_TAIL)


def test_a_motion_is_as_wide_as_its_layout():
    with pytest.raises(
        MotionInvalid, match=r"body_pose has shape \(5, 9\), but \(5, 69\) is expected of the layout SMPL"
    ):
        replace(tailed_motion(), body_layout=SMPL)
