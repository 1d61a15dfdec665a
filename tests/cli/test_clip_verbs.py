"""The verbs that edit clips, on files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.clips import take_frames
from solver_backend.exchange.motion_file import MotionFile, read_motion, write_motion
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import as_file
from solver_backend.io.native.motion_file import read_motion as read_solved
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.scenes import small_motion


@pytest.fixture
def walk(tmp_path: Path) -> MotionFile:
    """A motion with every optional array, as its file has it."""
    write_motion(tmp_path / "walk.npz", as_file(small_motion(frames=40), "walk"))
    return read_motion(tmp_path / "walk.npz", whole=True)


CASES: dict[str, tuple[str, ...]] = {
    "trim": ("--frames", "5", "20"),
    "mirror": (),
    "retime": ("--speed", "2"),
    "resample": ("--fps", "60"),
    "in-place": (),
    "root-motion": (),
}


@pytest.mark.parametrize("verb", CASES)
def test_a_verb_writes_a_motion_that_solves_can_read(
    verb: str, walk: MotionFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, out = tmp_path / "walk.npz", tmp_path / "out.npz"
    before = source.read_bytes()
    words = ["motion", verb, str(source), str(out), *CASES[verb]]
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    made = read_solved(out)
    assert result["motion"] == str(out) and result["frames"] == made.num_frames
    assert made.provenance["edits"][-1]["verb"] == f"motion {verb}"
    assert made.contacts is not None and made.joint_covariance is not None
    assert source.read_bytes() == before
    assert main(words) != 0 and "already exist" in capsys.readouterr().err


def test_clips_are_joined_and_looped(walk: MotionFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, joined = str(tmp_path / "walk.npz"), tmp_path / "joined.npz"
    assert main(["motion", "join", source, source, str(joined)]) == 0
    assert "joints are" in capsys.readouterr().out
    assert read_solved(joined).num_frames == 2 * walk.num_frames - 1
    assert main(["motion", "loop", source, str(tmp_path / "loop.npz")]) != 0
    assert not (tmp_path / "loop.npz").exists()
    assert "does not repeat" in capsys.readouterr().err


def test_a_range_of_a_clip_is_not_solved_again(
    walk: MotionFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capture, mirrored = str(tmp_path / "demo.npz"), str(tmp_path / "mirrored.npz")
    write_capture(Path(capture), demo_capture(40))
    assert main(["motion", "mirror", str(tmp_path / "walk.npz"), mirrored]) == 0
    words = ["solve", capture, "--resolve", mirrored, "--frames", "3", "9", "--out", str(tmp_path / "again.npz")]
    assert main(words) != 0
    assert "changed by motion mirror" in capsys.readouterr().err and not (tmp_path / "again.npz").exists()


def test_a_length_is_a_speed(walk: MotionFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = str(tmp_path / "walk.npz"), tmp_path / "out.npz"
    seconds = (walk.num_frames - 1) / walk.fps
    assert main(["motion", "retime", source, str(out), "--seconds", str(2 * seconds)]) == 0
    assert read_solved(out).num_frames == 2 * walk.num_frames - 1
    one = tmp_path / "one.npz"
    write_motion(one, take_frames(walk, np.zeros(1, int)))
    assert main(["motion", "retime", str(one), str(tmp_path / "two.npz"), "--seconds", "2"]) != 0
    assert "only one frame" in capsys.readouterr().err
    assert main(["motion", "retime", source, str(tmp_path / "no.npz")]) != 0
    assert np.isclose(read_solved(out).fps, walk.fps)
