"""Limbs that pass through the body are counted, those that touch or cross in the air are not."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics.self_intersection import (
    BONES,
    TOLERANCE_M,
    capsules_of,
    segment_distance,
    self_intersection_m,
    self_intersection_percent,
)


def posed(**turns: tuple[float, float, float]) -> np.ndarray:
    """Return the (1, 24, 3) joints of the mean body with some joints turned, rad."""
    rotvec = np.zeros((1, 21, 3))
    for name, turn in turns.items():
        rotvec[0, SMPL_JOINTS.index(name) - 1] = turn
    return forward_kinematics(load_body(), np.zeros(10), np.eye(3)[None], exp_so3(rotvec), np.zeros((1, 3))).joints


@pytest.mark.slow
def test_segments_are_as_far_apart_as_their_nearest_points():
    rng = np.random.default_rng(0)
    p, u, q, v = rng.normal(size=(4, 200, 3))
    v[:20] = 2.0 * u[:20]  # parallel
    share = np.linspace(0.0, 1.0, 201)
    one, other = (start[:, None] + share[:, None] * way[:, None] for start, way in ((p, u), (q, v)))
    by_search = np.linalg.norm(one[:, :, None] - other[:, None], axis=-1).min(axis=(1, 2))
    found = segment_distance(p, u, q, v)
    assert (found <= by_search + 1e-9).all()
    np.testing.assert_allclose(found, by_search, atol=0.03)


def test_a_hand_in_the_belly_and_a_leg_in_the_other_are_counted_to_their_depth():
    body = load_body()
    standing, crossed = posed(), posed(left_hip=(0.0, 0.0, -0.35))
    assert self_intersection_m(body, standing)[0] == 0.0
    radii = dict(zip(BONES, capsules_of(body).radii, strict=True))
    joints = standing.copy()
    pelvis, spine = (SMPL_JOINTS.index(name) for name in ("pelvis", "spine1"))
    wrist, hand = (SMPL_JOINTS.index(f"left_{name}") for name in ("wrist", "hand"))
    touching = radii["pelvis", "spine1"] + radii["left_wrist", "left_hand"]
    middle, along = 0.5 * (joints[0, pelvis] + joints[0, spine]), np.array([0.05, 0.0, 0.0])
    ahead = np.cross(along, joints[0, spine] - joints[0, pelvis])
    ahead /= np.linalg.norm(ahead)
    joints[0, SMPL_JOINTS.index("left_elbow")] = middle + (0.3, 0.0, 0.3)
    for deep in (-0.02, 0.01, 0.05):
        joints[0, wrist] = middle + along + (touching - deep) * ahead
        joints[0, hand] = middle - along + (touching - deep) * ahead
        assert self_intersection_m(body, joints)[0] == pytest.approx(max(deep, 0.0), abs=1e-9)
        assert self_intersection_percent(body, joints) == (100.0 if deep > TOLERANCE_M else 0.0)
    assert self_intersection_percent(body, np.concatenate([standing, crossed])) == 50.0


def test_neighbours_bend_without_being_counted():
    bent = posed(left_knee=(2.4, 0.0, 0.0), right_elbow=(0.0, 2.4, 0.0), spine2=(0.6, 0.0, 0.0))
    assert self_intersection_m(load_body(), bent)[0] < TOLERANCE_M
    assert self_intersection_m(load_body(), bent[:0]).shape == (0,)


def test_a_segment_of_no_length_is_a_point() -> None:
    zero, x = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0]])
    for u, v in ((zero, x), (x, zero), (zero, zero)):
        assert segment_distance(zero, u, np.array([[0.0, 2.0, 0.0]]), v) == pytest.approx(2.0)
