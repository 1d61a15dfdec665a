"""Markers of hands beside a body's: split off by their labels, and solved with the wrist that the body has."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hand_markers import LAYOUTS, hand_markers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.markers import marker_layout
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.fitters.measurements.hand_clouds import split_hands
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.hands.moving_hands import move_hands
from solver_backend.types import Capture, MarkerCloud
from tests.support.worn_markers import worn_markers

FRAMES, FPS = 40, 60.0


def cloud_of(*names: str) -> MarkerCloud:
    return MarkerCloud(np.zeros((3, len(names), 3)), FPS, names)


def test_labels_of_hands_are_split_off_by_side() -> None:
    body, hands = split_hands(cloud_of("LASI", "L_FT1", "left_PP2", "Lmp5", "Ann:RFT1", "RFT2", "right-MP2", "RKNE"))
    assert body.labels == ("LASI", "RKNE")
    assert hands is not None
    assert hands.labels == {0: ("FT1", "PP2", "MP5"), 1: ("FT1", "FT2", "MP2")}


def test_one_label_alone_is_no_hand() -> None:
    cloud = cloud_of("LASI", "LMP1", "RMP5", "LIP")
    assert split_hands(cloud) == (cloud, None)


@pytest.mark.parametrize(("layout", "largest_mm"), [("hand26", 12.0), ("hand10", 16.0), ("hand5", 30.0)])
def test_fingers_come_with_the_body(layout: str, largest_mm: float) -> None:
    labels = marker_layout("PLUGIN_GAIT_39")
    worn = worn_markers(labels, FRAMES, fps=FPS, stray_m=0.004)
    truth, body = demo_capture().truth, load_body()
    part = slice(0, FRAMES)
    local = exp_so3(truth["body_pose"][part, :63].reshape(-1, 21, 3))
    person = Person(body, truth["betas"], exp_so3(truth["global_orient"][part]), local, truth["transl"][part])
    hands = move_hands(person, FPS, np.random.default_rng(4))
    posed = forward_kinematics(body, person.betas, person.orient, person.local, person.transl)
    positions, names, wrist = [worn.cloud.positions], list(labels), body.layout.joints.index("left_wrist")
    for side, letter in enumerate("LR"):
        markers, skeleton = hand_markers(hands.skeletons[side], LAYOUTS[layout]), hands.skeletons[side]
        own = skeleton.sites(skeleton.pose(hands.angles[:, side]), markers.sites)
        G, place = posed.G[:, None, wrist + side], posed.joints[:, None, wrist + side]
        positions.append(place + (G @ own[..., None])[..., 0])
        names += [f"{letter}{label}" for label in markers.labels]
    cloud = MarkerCloud(np.concatenate(positions, axis=1), FPS, tuple(names))
    motion = solve(Capture("worn", markers=cloud)).motion
    assert motion.body_layout.joints == SMPL_HANDS.joints
    assert motion.marker_labels is not None and not set(motion.marker_labels) & set(names[len(labels) :])
    middles = [SMPL_HANDS.joints.index(f"{side}_index2") for side in ("left", "right")]
    error = 1000 * np.linalg.norm(motion.joints[:, middles] - hands.points[:, :, 6], axis=-1)
    assert error.mean() < largest_mm
