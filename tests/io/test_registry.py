"""A new format is a module and a row: the first reader that recognises a path reads it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import CaptureNotRecognised, JobInvalid, MotionInvalid
from solver_backend.io.load import CAPTURES, MOTIONS, load_capture, load_motion
from solver_backend.io.motions.amass import AmassClip
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.types import Capture, Motion
from tests.support.scenes import small_capture, small_motion
from tests.support.trial_files import write_trial

BVH = "HIERARCHY\nROOT Hips {\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\n"
BVH += "MOTION\nFrames: 2\nFrame Time: 0.1\n1 2 3 4 5 6\n"


def _toy(path: Path, options: ReadOptions) -> Capture:
    return Capture(f"{path.stem} at {options.fps:g}")


TOY = Reader("a toy .toy", lambda path: path.suffix == ".toy", _toy, frozenset({"fps"}))


def _amass(path: Path) -> Path:
    np.savez(path, poses=np.zeros((3, 156)), trans=np.zeros((3, 3)), mocap_framerate=np.array(30.0))
    return path


@pytest.mark.parametrize("reader", [*CAPTURES, *MOTIONS], ids=lambda reader: reader.kind)
def test_every_row_is_a_reader_that_knows_its_own(tmp_path: Path, reader: Reader) -> None:
    assert isinstance(reader, Reader)
    assert reader.kind
    for stranger in (tmp_path, tmp_path / "missing", tmp_path / "a.toy"):
        assert not reader.recognises(stranger)


def test_every_capture_is_read_by_one_reader(tmp_path: Path) -> None:
    write_trial(tmp_path / "S01_Walk")
    own = write_capture(tmp_path / "own.npz", small_capture(4))
    for path in (tmp_path / "S01_Walk", own):
        assert sum(reader.recognises(path) for reader in CAPTURES) == 1
        assert load_capture(path).keypoints is not None


def test_a_toy_reader_is_passed(tmp_path: Path) -> None:
    readers = (TOY, *CAPTURES)
    assert load_capture(tmp_path / "a.toy", readers=readers, fps=25.0).name == "a at 25"
    own = write_capture(tmp_path / "own.npz", small_capture(4))
    assert load_capture(own, readers=readers).num_frames == 4
    (tmp_path / "a.none").touch()
    with pytest.raises(CaptureNotRecognised, match="not a readable capture") as error:
        load_capture(tmp_path / "a.none", readers=readers)
    assert error.value.hint.startswith("Captures are a toy .toy; capture .npz of this program; a Pose2Sim trial folder")


def test_motions_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "a.bvh").write_text(BVH)
    clip = load_motion(tmp_path / "a.bvh", unit="m")
    assert isinstance(clip, BvhClip)
    np.testing.assert_allclose(clip.root_positions[0], [1.0, -3.0, 2.0])
    with pytest.raises(JobInvalid, match="Unknown unit 'ell'"):
        load_motion(tmp_path / "a.bvh", unit="ell")
    amass = load_motion(_amass(tmp_path / "b.npz"), fps=60.0)
    assert isinstance(amass, AmassClip)
    assert amass.fps == 60.0
    assert isinstance(load_motion(write_motion(tmp_path / "c.npz", small_motion(3))), Motion)
    with pytest.raises(MotionInvalid, match="not a readable motion"):
        load_motion(tmp_path)
