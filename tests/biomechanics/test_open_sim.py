"""OpenSim's coordinates: against inverse kinematics of recordings, and in OpenSim itself where it is installed.

The tests in OpenSim need ``pip install opensim`` and a model: ``MOCAP_OPENSIM_MODEL=Rajagopal2016.osim``, from
https://github.com/opensim-org/opensim-models. They were run with OpenSim 4.6, Rajagopal2016 and
RajagopalLaiUhlrich2023.
"""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from solver_backend.biomechanics.open_sim import coordinates, kinematics_setup, scale_setup
from solver_backend.biomechanics.segments import posed_segments
from solver_backend.body.body import load_body
from solver_backend.cli.main import main
from solver_backend.fitters.pipeline import solve
from solver_backend.io.load import load_capture
from solver_backend.io.markers.read import read_markers
from solver_backend.io.native.motion_file import write_motion
from tests.biomechanics.agreement import inverse_kinematics
from tests.support.open_sim import read_mot
from tests.support.still_pose import still


def walk(frames: int = 40) -> object:
    swing = np.sin(np.linspace(0, 2 * np.pi, frames))[:, None] * [0.4, 0.0, 0.0]
    bend = (1 - np.cos(np.linspace(0, 2 * np.pi, frames)))[:, None] * [0.4, 0.0, 0.0]
    arms = {"left_shoulder": np.array([0, 0, -1.2]), "right_shoulder": np.array([0, 0, 1.2])}
    motion = still(frames, left_hip=swing, right_hip=-swing, left_knee=bend, right_knee=bend[::-1], **arms)
    return replace(motion, transl=np.linspace([0, 0, 0], [0, -1, 0], frames))


def test_files_are_written_once_and_read_back(tmp_path, capsys):
    motion, folder = walk(), tmp_path / "out ü"
    write_motion(tmp_path / "walk.npz", motion)
    command = ["motion export", str(tmp_path / "walk.npz"), "--out", str(folder)]
    assert main(command) == 0
    out = capsys.readouterr().out
    assert "written" in out and "rotated by 90 degrees" in out  # the walk goes along -y of the world
    assert main(command) == 3 and main([*command, "--overwrite"]) == 0
    columns = read_mot(folder / "walk.mot")
    assert columns["time"][-1] == pytest.approx(0.39) and columns["pelvis_tx"][-1] - columns["pelvis_tx"][0] > 0.99
    assert np.ptp(columns["hip_flexion_r"]) == pytest.approx(np.degrees(0.8), abs=1.0)
    assert columns["knee_angle_r_beta"] == pytest.approx(np.radians(columns["knee_angle_r"]), abs=1e-6)  # As OpenSim.
    cloud = read_markers(folder / "walk_markers.trc").cloud
    posed = posed_segments(motion, load_body())
    names = list(cloud.labels)
    assert len(set(names)) == 40 and cloud.fps == 100.0
    hips = [cloud.positions[:, names.index(f"{side}HJC")] for side in "LR"]
    own = [posed.joints[f"{side}_hip"] for side in ("left", "right")]
    assert np.abs(np.linalg.norm(hips[0] - hips[1], axis=1) - np.linalg.norm(own[0] - own[1], axis=1)).max() < 1e-5
    table = (folder / "walk_angles.csv").read_text().splitlines()
    assert len(table) == 41 and table[0].startswith("time_s,interpolated,pelvis_rotation_deg,pelvis_rotation_sd_deg")


@pytest.mark.parametrize("failing", range(1, 6))
def test_all_files_are_written_or_none(failing, tmp_path, monkeypatch):
    write_motion(tmp_path / "walk.npz", walk())
    written, write = [], Path.write_text

    def full_after(path, text, **options):
        written.append(path)
        if len(written) == failing:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, text, **options)

    monkeypatch.setattr(Path, "write_text", full_after)
    assert main(["motion export", str(tmp_path / "walk.npz"), "--out", str(tmp_path / "new" / "out")]) == 3
    assert len(written) == failing and sorted(path.name for path in tmp_path.rglob("*")) == ["walk.npz"]


def test_a_name_with_signs_of_xml_is_kept():
    name = 'a "b" & <c>'
    for text in (scale_setup(name, name, name, 2, 1.0, 1.7), kinematics_setup(name, name, (), 2, 1.0)):
        tool = ElementTree.fromstring(text)[0]
        assert tool.get("name") == name and tool.findtext(".//marker_file") == name


def test_the_setup_names_the_model_from_any_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_motion(tmp_path / "walk.npz", walk(3))
    command = ["motion export", "walk.npz", "--out", "new", "--model", "any.osim"]
    assert main(command) == 3 and "The OpenSim model does not exist" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    (tmp_path / "any.osim").touch()
    assert main(command) == 0
    named = ElementTree.parse(tmp_path / "new" / "walk_scale.xml").findtext(".//model_file")
    assert Path(named).is_absolute() and Path(named).samefile(tmp_path / "any.osim")


@pytest.mark.slow
@pytest.mark.parametrize("take", ["walking1", "walkingTO1"])
def test_legs_agree_with_the_inverse_kinematics_of_a_recording(shared_data, take):
    """Subject4's angles were found by OpenSim from the same markers, with a model scaled by AddBiomechanics."""
    folder = shared_data / "markers" / "nimble" / "Subject4"
    motion = solve(load_capture(folder / "MarkerData" / f"{take}.trc")).motion
    rms = {name: off for name, off, *_ in inverse_kinematics(motion, folder / "IK" / f"{take}_ik.mot")}
    for name, most in {"hip_flexion": 2.5, "knee_angle": 3.0, "hip_adduction": 4.0}.items():
        assert max(rms[f"{name}_l"], rms[f"{name}_r"]) < most, name


@pytest.fixture
def opensim():
    package = pytest.importorskip("opensim", reason="OpenSim is not installed: pip install opensim")
    if not Path(os.environ.get("MOCAP_OPENSIM_MODEL", "")).is_file():
        pytest.skip("no model: set MOCAP_OPENSIM_MODEL to Rajagopal2016.osim")
    package.Logger.setLevelString("off")
    return package


def test_opensim_has_the_coordinates_and_its_segments_are_ours(opensim):
    """OpenSim poses the model by the coordinates. Its joint centres then have the directions of ours."""
    model = opensim.Model(os.environ["MOCAP_OPENSIM_MODEL"])
    state, motion = model.initSystem(), walk()
    posed = posed_segments(motion, load_body())
    found, centre = coordinates(posed), {}
    for k in range(0, motion.num_frames, 5):
        for name, value in zip(found.names, found.values[k], strict=True):
            kept = name in ("pelvis_tx", "pelvis_ty", "pelvis_tz") or name.endswith("beta")
            model.updCoordinateSet().get(name).setValue(state, value if kept else np.radians(value), False)
        model.realizePosition(state)
        for label, body in (("hip", "femur"), ("knee", "tibia"), ("ankle", "talus"), ("shoulder", "humerus"),
                            ("elbow", "ulna"), ("wrist", "hand")):  # fmt: skip
            for side in ("left", "right"):
                p = model.getBodySet().get(f"{body}_{side[0]}").getPositionInGround(state)
                centre.setdefault(f"{side}_{label}", []).append([p.get(i) for i in range(3)])
    for upper, lower, most in (
        ("hip", "knee", 4),
        ("knee", "ankle", 4),
        ("shoulder", "elbow", 6),
        ("elbow", "wrist", 9),
    ):
        for side in ("left", "right"):
            theirs = np.subtract(centre[f"{side}_{lower}"], centre[f"{side}_{upper}"])
            ours = ((posed.joints[f"{side}_{lower}"] - posed.joints[f"{side}_{upper}"]) @ posed.ground.T)[::5]
            cosine = (theirs * ours).sum(1) / np.linalg.norm(theirs, axis=1) / np.linalg.norm(ours, axis=1)
            assert np.degrees(np.arccos(cosine)).max() < most, (side, upper)


def test_the_motion_file_opens_and_moves_the_model(opensim, tmp_path):
    """OpenSim reads the file as a motion of the model, and its joint centres move as ours do."""
    motion = walk()
    write_motion(tmp_path / "walk.npz", motion)
    assert main(["motion export", str(tmp_path / "walk.npz"), "--out", str(tmp_path)]) == 0
    model, storage = opensim.Model(os.environ["MOCAP_OPENSIM_MODEL"]), opensim.Storage(str(tmp_path / "walk.mot"))
    state, places = model.initSystem(), []
    model.getSimbodyEngine().convertDegreesToRadians(storage)
    assert storage.getSize() == motion.num_frames
    for k in range(motion.num_frames):
        row = storage.getStateVector(k).getData()
        for i in range(row.size()):
            model.updCoordinateSet().get(storage.getColumnLabels().get(i + 1)).setValue(state, row.get(i), False)
        knee, kneecap = (
            model.getCoordinateSet().get(name).getValue(state) for name in ("knee_angle_r", "knee_angle_r_beta")
        )
        assert kneecap == pytest.approx(knee, abs=1e-6)
        model.realizePosition(state)
        points = [model.getBodySet().get(name).getPositionInGround(state) for name in ("pelvis", "calcn_l")]
        places.append([[p.get(i) for i in range(3)] for p in points])
    pelvis, heel = np.moveaxis(np.array(places), 1, 0)
    posed = posed_segments(motion, load_body())
    ours = [posed.joints[name] @ posed.ground.T for name in ("pelvis", "left_ankle")]
    assert np.abs((pelvis - pelvis[0]) - (ours[0] - ours[0][0])).max() < 0.005
    assert np.ptp(heel - pelvis, axis=0)[0] > 0.3
    ways = [np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for points in (heel - pelvis, ours[1] - ours[0])]
    assert ways[0] == pytest.approx(ways[1], rel=0.15)


@pytest.mark.slow
def test_opensim_scales_its_model_and_finds_the_angles_by_inverse_kinematics(opensim, tmp_path, monkeypatch):
    write_motion(tmp_path / "walk.npz", walk(20))
    model = str(Path(os.environ["MOCAP_OPENSIM_MODEL"]).resolve())
    assert main(["motion export", str(tmp_path / "walk.npz"), "--out", str(tmp_path), "--model", model]) == 0
    monkeypatch.chdir(tmp_path)
    assert opensim.ScaleTool("walk_scale.xml").run() and opensim.InverseKinematicsTool("walk_ik.xml").run()
    ours, theirs = read_mot(tmp_path / "walk.mot"), read_mot(tmp_path / "walk_ik.mot")
    for name in ("hip_flexion", "knee_angle", "ankle_angle", "hip_adduction", "arm_flex", "elbow_flex"):
        for side in "lr":
            off = ours[f"{name}_{side}"] - theirs[f"{name}_{side}"]
            # The constant part depends on the shapes of both pelvises and torsos (biomechanics.md).
            assert off.std() < 4.0 and abs(off.mean()) < 12.0, (name, side, off.mean())
            assert name not in ("knee_angle", "ankle_angle") or np.sqrt((off**2).mean()) < 4.0
