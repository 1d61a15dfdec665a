"""3D joint centres in, a body out: suits and keypoints by name; skin markers with such names are doubted."""

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.joint_names import joint_centre_places
from solver_backend.body.markers import marker_landmarks
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.marker_calibration.person_doubts import STRANGE, WIDEST
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.load import load_capture
from solver_backend.io.markers.camera_systems import write_trc
from solver_backend.report.checks import diagnose, recorded_diagnostics
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import SMPL_JOINTS, Capture, MarkerCloud
from tests.support.skeleton_labels import POSE2SIM, SUIT
from tests.support.words import words
from tests.support.worn_markers import worn_markers

LIMBS = [
    f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
]
COLUMNS = [SMPL_JOINTS.index(name) for name in LIMBS]
SETTINGS = SolveSettings(contacts=False)
FRAMES = 90


def recorded(labels, sigma_m=0.003, frames=FRAMES):
    """Return a skeleton's points of the demo's person and its true joints."""
    truth, body, rng = demo_capture().truth, load_body(), np.random.default_rng(4)
    places = {label: place for label, place in joint_centre_places(labels).items() if place}
    landmarks = marker_landmarks(body, tuple(places.values()))
    subject = Subject(body, landmarks, truth["betas"], 0.0 * rng.normal(size=(len(places), 3)))
    chosen = slice(0, 2 * frames, 2)
    local = exp_so3(truth["body_pose"][chosen, :63].reshape(-1, 21, 3))
    posed = PosedFrames(exp_so3(truth["global_orient"][chosen]), local, truth["transl"][chosen])
    points = pose(subject, posed).points + sigma_m * rng.normal(size=(frames, len(places), 3))
    return MarkerCloud(points, 30.0, tuple(places)), truth["joints"][chosen]


def error_mm(motion, joints):
    return 1000 * np.linalg.norm(motion.joints[:, COLUMNS] - joints[:, COLUMNS], axis=-1).mean(axis=0)


@pytest.mark.parametrize("labels", [pytest.param(SUIT, marks=pytest.mark.slow), POSE2SIM], ids=["suit", "pose2sim"])
def test_joint_centres_make_a_body(labels):
    cloud, joints = recorded(labels, frames=50)
    motion = solve(Capture("points", markers=cloud), SETTINGS).motion
    assert error_mm(motion, joints).max() < 15
    assert np.abs(motion.betas).max() < 3
    assert not [item for item in recorded_diagnostics(motion) if item.code == "joints_doubted"]


def test_files_of_points_are_read_alike(tmp_path):
    cloud, _ = recorded(POSE2SIM)
    write_trc(tmp_path / "points.trc", cloud)
    np.save(tmp_path / "array.npy", cloud.positions)
    (tmp_path / "array.txt").write_text("\n".join(POSE2SIM))
    for capture in (load_capture(tmp_path / "points.trc"), load_capture(tmp_path / "array.npy", fps=30.0)):
        assert capture.markers.labels == POSE2SIM
        assert any("joint centres" in note for note in words(capture.notes))
        assert capture.markers.positions == pytest.approx(cloud.positions, abs=1e-4)


@pytest.mark.slow
def test_markers_on_the_skin_with_a_skeletons_names_are_doubted():
    names = {
        "LGTR": "LeftThigh", "LKNE": "LeftLeg", "LANK": "LeftFoot", "LTOE": "LeftToe", "RGTR": "RightThigh",
        "RKNE": "RightLeg", "RANK": "RightFoot", "RTOE": "RightToe", "LSHO": "LeftArm", "LELB": "LeftForearm",
        "LWRA": "LeftHand", "RSHO": "RightArm", "RELB": "RightForearm", "RWRA": "RightHand",
    }  # fmt: skip
    take = worn_markers(tuple(names), FRAMES, fps=30.0, step=2)
    cloud = MarkerCloud(take.cloud.positions, 30.0, tuple(names.values()))
    motion = solve(Capture("skin", markers=cloud), SETTINGS).motion
    (found,) = [item for item in recorded_diagnostics(motion) if item.code == "joints_doubted"]
    assert found.values["size"] > 64


@pytest.mark.slow
def test_a_waist_that_passes_for_hips_is_doubted_by_the_shape():
    names = {
        "LFWT": "LeftHip", "RFWT": "RightHip", "LKNE": "LeftKnee", "RKNE": "RightKnee", "LANK": "LeftAnkle",
        "RANK": "RightAnkle", "LTOE": "LeftToe", "RTOE": "RightToe", "LHEE": "LeftHeel", "RHEE": "RightHeel",
        "LSHO": "LeftShoulder", "RSHO": "RightShoulder", "LELB": "LeftElbow", "RELB": "RightElbow",
        "LWRA": "LeftWrist", "RWRA": "RightWrist", "LFHD": "Head", "C7": "Neck",
    }  # fmt: skip
    take = worn_markers(tuple(names), FRAMES, fps=30.0, step=2)
    motion = solve(Capture("skin", markers=MarkerCloud(take.cloud.positions, 30.0, tuple(names.values()))), SETTINGS)
    (found,) = [item for item in recorded_diagnostics(motion.motion) if item.code == "joints_doubted"]
    assert found.values["shape"] > STRANGE and found.values["size"] < 100 * WIDEST


@pytest.mark.slow
def test_a_take_that_sinks_is_reported():
    cloud, _ = recorded(SUIT)
    sinking = cloud.positions - np.linspace(0.0, 2.0, FRAMES)[:, None, None] * [0.0, 0.0, 1.0]
    capture = Capture("sinks", markers=MarkerCloud(sinking, 30.0, cloud.labels))
    motion = solve(capture, SETTINGS).motion
    (found,) = [item for item in diagnose(capture, motion) if item.code == "take_drifts"]
    assert found.values["size"] == pytest.approx(2.0, abs=0.5) and found.values["way"] == "sinks"
