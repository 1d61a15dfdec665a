"""A body measured in part: seen joints as without rest, the others hanging, flagged, and honestly unsure."""

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import sentence
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.pipeline import resolve_range
from solver_backend.fitters.rest_parts import listed
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.report.checks import recorded_diagnostics
from solver_backend.types import FLAG_RESTING, FLAG_UNSURE, SMPL_JOINTS, Capture, MarkerCloud
from tests.support.worn_markers import worn_markers

LEGS = (
    "LASI", "RASI", "LPSI", "RPSI", "LTHI", "LKNE", "LTIB", "LANK", "LHEE", "LTOE", "RTHI", "RKNE", "RTIB", "RANK",
    "RHEE", "RTOE",
)  # fmt: skip
REST = ("C7", "T10", "CLAV", "STRN", "LSHO", "RSHO", "LFHD", "RFHD", "LBHD", "RBHD")
ARMS = ("LUPA", "LELB", "LFRM", "LWRA", "LFIN", "RUPA", "RELB", "RFRM", "RWRA", "RFIN")
SETTINGS = SolveSettings(contacts=False)


def worn_by_all(frames):
    take = worn_markers((*LEGS, *REST, *ARMS), frames, fps=30.0, step=2)
    return take, solve(Capture("whole", markers=take.cloud), SETTINGS).motion


@pytest.fixture(scope="module")
def whole():
    return worn_by_all(120)


@pytest.fixture(scope="module")
def short():
    return worn_by_all(60)


def part_of(take, labels):
    columns = [take.cloud.labels.index(label) for label in labels]
    return take.cloud.columns(columns, tuple(labels))


def error_mm(motion, truth, names):
    columns = [SMPL_JOINTS.index(name) for name in names]
    return 1000 * np.linalg.norm(motion.joints[:, columns] - truth[:, columns], axis=-1).mean()


@pytest.mark.slow
def test_a_whole_body_has_nothing_at_rest(short):
    _, motion = short
    assert motion.resting is None and not (motion.flags & FLAG_RESTING).any()
    assert not recorded_diagnostics(motion)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("labels", "knees"),
    [(("LANK", "LHEE", "LTOE", "LMT5", "RANK", "RHEE", "RTOE", "RMT5"), True),
     (("LKNE", "LTIB", "LANK", "LHEE", "LTOE", "RKNE", "RTIB", "RANK", "RHEE", "RTOE"), False)],
    ids=["feet", "lower legs"],
)  # fmt: skip
def test_what_stands_above_feet_alone_is_assumed(labels, knees):
    take = worn_markers((*labels, "LASI", "RASI"), 60, fps=30.0, step=2)
    motion = solve(Capture("feet", markers=part_of(take, labels)), SETTINGS).motion
    at = SMPL_JOINTS.index
    assumed = [at(name) for name in ("pelvis", "left_hip", "spine1", "head")]
    assert motion.resting is not None and motion.joint_sigma is not None
    assert motion.resting[:, assumed].all() and not motion.resting[:, [at("left_ankle"), at("right_foot")]].any()
    assert motion.resting[:, at("left_knee")].all() == knees
    assert (motion.joint_sigma[:, assumed] > 0.05).all() and (motion.joint_sigma[:, at("left_ankle")] < 0.03).all()
    assert error_mm(motion, take.joints, ["left_ankle", "right_ankle"]) < 20.0
    assert "place_assumed" in [item.code for item in recorded_diagnostics(motion)]


def test_legs_alone(short, tmp_path):
    take, full = short
    motion = solve(Capture("legs", markers=part_of(take, LEGS)), SETTINGS).motion
    at = SMPL_JOINTS.index
    for side in ("left", "right"):
        assert (motion.joints[:, at(f"{side}_wrist"), 2] < motion.joints[:, at(f"{side}_shoulder"), 2] - 0.3).all()
    unseen = [at(name) for name in ("head", "left_elbow", "right_wrist", "spine3")]
    seen = [f"{side}_{joint}" for side in ("left", "right") for joint in ("hip", "knee", "ankle")]
    assert motion.resting[:, unseen].all() and not motion.resting[:, [at(name) for name in seen]].any()
    assert motion.flags is not None and motion.resting is not None
    assert (motion.flags & FLAG_RESTING).all() and (motion.flags & FLAG_UNSURE > 0).mean() < 0.1
    assert (motion.joint_sigma[:, at("left_wrist")] > 0.15).all()
    assert error_mm(motion, take.joints, seen) < 1.15 * error_mm(full, take.joints, seen) + 1.0
    (found,) = recorded_diagnostics(motion)
    assert sentence(found).startswith("Arms, trunk and head have no markers, so a relaxed pose is shown.")
    assert np.abs(motion.betas).max() < 4
    again = read_motion(write_motion(tmp_path / "legs.npz", motion))
    assert np.array_equal(again.resting, motion.resting)


@pytest.mark.slow
def test_arms_that_are_seen_for_a_second_are_informed_there(whole):
    take, full = whole
    points = take.cloud.positions.copy()
    arms = [take.cloud.labels.index(label) for label in ARMS]
    points[:40, arms] = points[70:, arms] = np.nan
    motion = solve(Capture("some", markers=MarkerCloud(points, 30.0, take.cloud.labels)), SETTINGS).motion
    wrist = SMPL_JOINTS.index("left_wrist")
    assert not motion.resting[40:70, wrist].any() and motion.resting[:10, wrist].all()
    off = np.linalg.norm(motion.joints - full.joints, axis=-1)[45:65, wrist]
    assert off.max() < 0.03
    speed = np.linalg.norm(np.diff(motion.joints[:, wrist], axis=0), axis=-1) * 30
    assert speed.max() < 6.0
    assert (motion.flags[45:65] & FLAG_RESTING == 0).all()


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (["left_upper_arm", "left_forearm", "right_upper_arm", "right_forearm", "head"], "Arms and head"),
        (["left_upper_arm", "left_forearm"], "Left arm"),
        (["left_forearm", "right_forearm"], "Forearms"),
        (["left_thigh", "right_thigh", "left_shank", "right_shank", "right_forearm"], "Right forearm and legs"),
        (["trunk"], "Trunk"),
    ],
)
def test_parts_in_words(parts, words):
    assert listed(parts) == words


@pytest.mark.slow
def test_a_pose_that_somebody_set_on_a_resting_arm_is_kept(whole):
    take, _ = whole
    capture = Capture("legs", markers=part_of(take, LEGS))
    motion = solve(capture, SETTINGS).motion
    shoulder = slice(3 * (SMPL_JOINTS.index("left_shoulder") - 1), 3 * SMPL_JOINTS.index("left_shoulder"))
    raised = motion.body_pose[60].copy()
    raised[shoulder] = 0.0  # as in a T-pose
    pin = Pin(60, motion.global_orient[60], raised, motion.transl[60])
    again = resolve_range(capture, motion, FrameRange(20, 100, (pin,)), SETTINGS).motion
    assert again.body_pose[60] == pytest.approx(raised, abs=1e-5)
    assert again.resting is not None
    wrist = SMPL_JOINTS.index("left_wrist")
    assert not again.resting[60, wrist] and again.resting[22, wrist]
    speed = np.linalg.norm(np.diff(again.joints[:, wrist], axis=0), axis=-1) * 30
    assert speed.max() < 6.0


@pytest.mark.slow
def test_a_stretch_solved_again_keeps_its_resting_arms(whole):
    take, _ = whole
    capture = Capture("legs", markers=part_of(take, LEGS))
    motion = solve(capture, SETTINGS).motion
    again = resolve_range(capture, motion, FrameRange(40, 80, ()), SETTINGS).motion
    assert np.array_equal(again.resting, motion.resting)
    assert np.abs(again.joints - motion.joints).max() < 0.03
