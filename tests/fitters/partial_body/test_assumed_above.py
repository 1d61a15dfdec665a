"""Joints beyond what is measured: none of a whole body, and honestly unsure behind limbs alone."""

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.rest_parts import assumed_joints
from solver_backend.report.checks import recorded_diagnostics
from solver_backend.types import SMPL_JOINTS, Capture, JointSet
from tests.support.worn_markers import worn_markers

ARM = ("LSHO", "LUPA", "LELB", "LFRM", "LWRA", "LWRB", "LFIN")
LEG = ("RTHI", "RKNE", "RTIB", "RANK", "RHEE", "RTOE")
CHEST = ("C7", "T10", "CLAV", "STRN", "LSHO", "RSHO", "LFHD", "RFHD", "LBHD", "RBHD")
HANDS = (*ARM[1:], *("R" + place[1:] for place in ARM[1:]))
PELVIS = ("pelvis", "left_hip", "right_hip", "spine1")


def assumed(landmarks, offsets=0.0):
    offsets = np.full((len(landmarks), 3), offsets)
    return assumed_joints(load_body(), landmarks, offsets, np.ones((1, len(landmarks)), bool))


@pytest.mark.parametrize("joint_set", [*JointSet])
def test_no_set_of_keypoints_leaves_places_to_be_assumed(joint_set):
    assert not assumed(keypoint_landmarks(load_body(), joint_set))


@pytest.mark.parametrize("layout", [*load_layouts().layouts])
def test_no_layout_leaves_places_to_be_assumed(layout):
    assert not assumed(marker_landmarks(load_body(), marker_layout(layout)))


def test_a_pelvis_without_markers_is_assumed_unless_legs_are_seen():
    found = assumed(marker_landmarks(load_body(), (*CHEST, *HANDS)))
    assert set(PELVIS) < set(found) and not {"spine2", "spine3", "head", "left_elbow"} & set(found)
    assert 0.03 < found["pelvis"] < 0.06
    assert not assumed(marker_landmarks(load_body(), (*CHEST, *LEG)))


def test_heels_do_not_show_where_knees_and_a_pelvis_without_markers_are():
    ends = (*CHEST, "LHEE", "RHEE", "LANK", "RANK", "LTOE", "RTOE")
    found = assumed(marker_landmarks(load_body(), ends))
    assert set(found) == {*PELVIS, "left_knee", "right_knee"}
    assert not assumed(marker_landmarks(load_body(), (*ends, "LFWT", "RFWT", "SACR")))


def test_a_marker_is_where_its_offset_puts_it():
    on_thigh = marker_landmarks(load_body(), (*LEG, "@right_hip"))
    assert "right_hip" not in assumed(on_thigh) and "right_hip" in assumed(on_thigh, offsets=0.2)


def test_limbs_alone_do_not_show_where_they_come_from():
    both = tuple("L" + place[1:] for place in LEG) + LEG
    one, two = (assumed(marker_landmarks(load_body(), labels)) for labels in (LEG, both))
    assert {*PELVIS, "left_knee"} < set(one) and set(PELVIS) < set(two)
    assert "right_knee" not in one and one["right_hip"] > 0.1 > two["right_hip"] > 0.04
    arm = assumed(marker_landmarks(load_body(), ARM))
    assert arm["pelvis"] > 0.25 > arm["left_shoulder"] > 0.02 and "left_elbow" not in arm


@pytest.mark.parametrize(
    ("labels", "seen", "words"),
    [
        (ARM, ("left_elbow", "left_wrist"), "Right arm, legs and head"),
        pytest.param(LEG, ("right_knee", "right_ankle"), "Arms, left leg, trunk and head", marks=pytest.mark.slow),
    ],
    ids=["arm", "leg"],
)
def test_a_limb_alone_is_solved(labels, seen, words):
    take = worn_markers((*labels, "LASI", "RASI"), 30, fps=30.0, step=2)
    cloud = take.cloud.columns([take.cloud.labels.index(label) for label in labels], labels)
    motion = solve(Capture("limb", markers=cloud), SolveSettings(contacts=False)).motion
    columns = [SMPL_JOINTS.index(joint) for joint in seen]
    off = np.linalg.norm(motion.joints[:, columns] - take.joints[:, columns], axis=-1)
    assert np.median(off) < 0.025 and motion.resting is not None and not motion.resting[:, columns].any()
    assert motion.resting[:, SMPL_JOINTS.index("pelvis")].all() and motion.flags is not None and motion.flags.all()
    assert (motion.joint_sigma[:, SMPL_JOINTS.index("pelvis")] > 0.1).all()
    rest, place = recorded_diagnostics(motion)
    assert (rest.code, place.code) == ("parts_at_rest", "place_assumed")
    assert rest.values["part"].startswith(words)
