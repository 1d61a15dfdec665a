"""Hands of the studio's people: fingers stay within people's ranges, the body hides them, detectors err by the palm."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.hand_skeleton import finger_overlap
from solver_backend.body.hands import finger_rotations, with_fingers
from solver_backend.cameras.projection import project
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.synthesis.studio.person_hands import HandFaults, detect_hands, move_hands
from solver_backend.types import Cameras
from tests.support.handed_take import HandedTake, handed_take

STILL = HandFaults(0.05, 0.05, 0.04, missing=0.0, wrong=0.0, exchanged=0.0, least_seen=0.0)


@pytest.fixture(scope="module")
def take() -> HandedTake:
    return handed_take(60, seed=4)


@pytest.fixture
def cameras(take: HandedTake) -> Cameras:
    return take.capture.require_multiview()[0]


def test_fingers_stay_within_their_ranges_and_move(take: HandedTake) -> None:
    prior, angles = load_hand_prior(), take.hands.angles
    assert ((angles >= prior.low - 1e-12) & (angles <= prior.high + 1e-12)).all()
    assert np.rad2deg(angles.std(axis=0)).mean() > 5


def test_no_finger_runs_through_another(take: HandedTake) -> None:
    for seed in range(4):
        hands = move_hands(take.person, 30.0, np.random.default_rng(seed))
        assert max(finger_overlap(hands.points[:, side]).max() for side in range(2)) < 0.003
        assert np.abs(np.diff(hands.angles, axis=0)).max() < np.deg2rad(12)


def test_points_are_those_of_the_bodys_own_finger_joints(take: HandedTake) -> None:
    mean_person = with_fingers(take.person.body)
    assert take.hands.rotations().shape == finger_rotations(mean_person, take.hands.angles).shape
    wrists = np.linalg.norm(take.hands.points[:, :, 9] - take.hands.points[:, :, 0], axis=-1)
    assert (np.ptp(wrists, axis=0) < 1e-9).all()
    assert (wrists.mean() > 0.07) & (wrists.mean() < 0.12)


def test_the_body_hides_some_points_but_no_hand_hides_itself(take: HandedTake) -> None:
    assert 0.02 < take.hidden.mean() < 0.5
    assert (~take.hidden.all(axis=(1, 2, 3))).all()


def test_errors_are_shares_of_the_palm(take: HandedTake, cameras: Cameras) -> None:
    px = project(cameras, take.hands.points)
    nothing = np.zeros_like(take.hidden)
    rng = np.random.default_rng(0)
    one, two = (
        detect_hands(cameras, take.hands.points, nothing, 30.0, faults, rng)
        for faults in (STILL, HandFaults(0.1, 0.1, 0.08, missing=0.0, wrong=0.0, exchanged=0.0, least_seen=0.0))
    )
    errors = [np.sqrt(np.nanmean((found[..., :2] - px) ** 2)) for found in (one, two)]
    assert 1.8 < errors[1] / errors[0] < 2.2
    assert errors[0] < 6


def test_hands_that_are_mostly_hidden_are_not_found_and_exchanged_ones_are(take: HandedTake, cameras: Cameras) -> None:
    rng = np.random.default_rng(1)
    found = detect_hands(cameras, take.hands.points, np.ones_like(take.hidden), 30.0, HandFaults(), rng)
    assert not found[..., 2].any()
    swapped = detect_hands(
        cameras, take.hands.points, np.zeros_like(take.hidden), 30.0, HandFaults(exchanged=0.999, missing=0.0), rng
    )
    px = project(cameras, take.hands.points)
    near = np.linalg.norm(swapped[:, :, 0, 0, :2] - px[:, :, 1, 0], axis=-1)
    assert np.nanmedian(near) < 6
