"""Hands of one camera: fingers nearer to the truth than hands at rest, with deviations that hold it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.hand_skeleton import FINGER_OF, JOINT_OF, KIND_OF
from solver_backend.body.hands import by_finger, hand_of_shape, load_body_with_hands
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.fitters.pipeline import solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Motion
from tests.support.handed_take import HandedTake, handed_take

FLEXIONS = np.flatnonzero((FINGER_OF > 0) & (KIND_OF == 0) & (JOINT_OF < 2))
CHI2_95 = 7.815
VIEW = 1


@pytest.fixture(scope="module")
def take() -> HandedTake:
    return handed_take(45, seed=2)


@pytest.fixture(scope="module")
def motion(take: HandedTake) -> Motion:
    return solve(replace(take.capture.views([VIEW]), truth={})).motion


def seen(take: HandedTake, side: int) -> np.ndarray:
    keypoints = take.capture.keypoints
    assert keypoints is not None and keypoints.hands is not None
    return (keypoints.hands[VIEW, :, side, :, 2] > 0).any(axis=-1)


@pytest.mark.slow
def test_fingers_are_nearer_to_the_truth_than_hands_at_rest(take: HandedTake, motion: Motion) -> None:
    body, rest = load_body_with_hands(), load_hand_prior().mean[FLEXIONS]
    turns = exp_so3(motion.body_pose.reshape(motion.num_frames, -1, 3))
    solved, resting = [], []
    for side, name in enumerate(SIDES):
        local = turns[:, np.array(SMPL_HANDS.group(f"{name}_hand")) - 1]
        angles = hand_of_shape(body, motion.betas, side).angles_of(by_finger(local))
        true = take.hands.angles[seen(take, side), side][:, FLEXIONS]
        solved.append(angles[seen(take, side)][:, FLEXIONS] - true)
        resting.append(rest - true)
    errors = [np.rad2deg(np.sqrt((np.concatenate(e) ** 2).mean())) for e in (solved, resting)]
    assert errors[0] < 0.8 * errors[1]


def test_the_deviations_hold_the_truth_and_are_largest_in_depth(take: HandedTake, motion: Motion) -> None:
    assert motion.joint_covariance is not None and take.capture.cameras is not None
    sight = take.capture.cameras.R[VIEW, 2]
    for side, name in enumerate(SIDES):
        columns = list(SMPL_HANDS.group(f"{name}_hand"))
        points = by_finger(motion.joints[:, columns]).reshape(motion.num_frames, 15, 3)[seen(take, side)]
        covariance = by_finger(unpacked(motion.joint_covariance[:, columns].astype(float)))
        covariance = covariance.reshape(motion.num_frames, 15, 3, 3)[seen(take, side)]
        true = take.hands.points[:, side][:, np.delete(np.arange(1, 21), [3, 7, 11, 15, 19])][seen(take, side)]
        off = points - true
        square = (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=-1)
        assert (square < CHI2_95).mean() > 0.85
        along = np.einsum("a,fjab,b->fj", sight, covariance, sight)
        assert (along > 0.5 * np.trace(covariance, axis1=-2, axis2=-1)).mean() > 0.9


def test_hands_of_one_camera_are_named_as_such(motion: Motion) -> None:
    found = {item.code: item for item in read_diagnostics(motion.provenance["diagnostics"])}
    assert found["hands_one_view"].severity.value == "warning" and "hands" in motion.provenance
