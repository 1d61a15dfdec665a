"""A rendered person before three sensors: live at the recorded rate, recorded on the way, solved at the end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from solver_backend.cli.main import main
from solver_backend.io.native.capture_file import read_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.sensors.devices.recorded import open_folder
from solver_backend.synthesis.studio.data_set import SHOTS, make_data_set
from solver_backend.synthesis.studio.spec import spec_of
from tests.support.vmc_receiver import Avatar, Receiver

FPS, FRAMES = 5, 18
"""So slow that a busy machine keeps up; what follows in the choreography is too fast to be labelled at this rate."""


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a shot of infrared and depth, 53 markers."""
    place = tmp_path_factory.mktemp("studio")
    spec = spec_of({
        "seed": 5, "fps": FPS, "frames": FRAMES, "motions": ["choreography"], "camera_arrays": ["azure_kinect_3"],
        "looks": ["suit"], "film": ["infrared", "depth"],
    })  # fmt: skip
    make_data_set(spec, place)
    return next((place / SHOTS).iterdir())


@pytest.mark.slow
def test_what_was_live_is_recorded_and_solved(
    shot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    take, out, lines = tmp_path / "take", tmp_path / "motion.npz", tmp_path / "poses.jsonl"
    command = ["sensors live", str(shot), "--poses", "--record", str(take), "--solve", str(out), "--lines", str(lines)]
    receiver = Receiver()
    assert main([*command, "--send", receiver.address, "--json"]) == 0
    packets = receiver.close()
    said = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert said["event"] == "result" and said["recorded"] == str(take) and said["solved"] == str(out)
    written = {name: end["written"] for name, end in said["sensors"].items()}
    assert {d.name: d.count() for d in open_folder(take).devices} == written
    assert min(written.values()) >= FRAMES // 2 and not said["stopped"]

    truth = read_capture(shot / "clean.npz").truth["joints"][:, :22]
    live = [json.loads(line) for line in lines.read_text("utf-8").splitlines()]
    assert said["poses"]["frames"] == sum("frame" in line for line in live) > 0
    poses = [line for line in live if "pose" in line]
    assert len(poses) == len(packets) == said["sent"] > 0
    x, y, z = Avatar().receive(packets[-1]).world("Hips")[1]
    assert np.abs(np.array([-x, -z, y]) - truth[:, 0]).max(-1).min() < 0.2
    motion = read_motion(out)
    assert max(written.values()) >= motion.num_frames >= min(written.values()) - 1
    # Frames that were lost may leave no gap: each solved frame is held against the moment that it is nearest to.
    off = np.linalg.norm(motion.joints[:, None, :22] - truth, axis=-1).mean(-1)
    assert 1e3 * np.median(off.min(1)) < 15.0
    assert (np.diff(off.argmin(1)) >= 0).all()

    # What is there already is kept, and said before a sensor opens.
    assert main([*command, "--json"]) != 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["code"] == "output_exists"
