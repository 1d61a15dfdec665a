"""Fingers bend where they should: angles come back, derivatives agree with differences, sides mirror each other."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.hand_skeleton import ANGLES, NUM_ANGLES, HandSites, HandSkeleton, measure_angles
from solver_backend.exchange.joint_sets import HAND_POINTS
from tests.support.open_hand import open_hand

RNG = np.random.default_rng(4)
TWIST = ANGLES.index("thumb_cmc_twist")


def random_angles(count: int) -> np.ndarray:
    angles = RNG.uniform(-0.2, 1.2, (count, NUM_ANGLES))
    angles[:, [i for i, name in enumerate(ANGLES) if name.endswith("spread")]] *= 0.3
    return angles


@pytest.mark.parametrize("side", [0, 1])
def test_angles_of_a_posed_hand_are_the_ones_it_was_posed_by(side: int) -> None:
    hand = HandSkeleton.of_points(open_hand(side), side)
    angles = random_angles(20)
    angles[:, TWIST] = 0.0
    points = hand.sites(hand.pose(angles), hand.keypoints())
    np.testing.assert_allclose(measure_angles(points, side), angles, atol=1e-9)


@pytest.mark.parametrize("side", [0, 1])
def test_at_its_rest_angles_a_hand_is_at_rest(side: int) -> None:
    points = open_hand(side) + RNG.normal(0, 0.002, (21, 3))
    hand = HandSkeleton.of_points(points, side)
    np.testing.assert_allclose(hand.points_at_rest, points - points[0], atol=1e-12)
    at_rest = hand.rest_angles[None]
    np.testing.assert_allclose(hand.sites(hand.pose(at_rest), hand.keypoints())[0], hand.points_at_rest, atol=1e-9)
    np.testing.assert_allclose(hand.local_rotations(at_rest), np.broadcast_to(np.eye(3), (1, 5, 3, 3, 3)), atol=1e-9)


@pytest.mark.parametrize("side", [0, 1])
def test_derivatives_agree_with_differences(side: int) -> None:
    hand = HandSkeleton.of_points(open_hand(side), side)
    count = 30
    sites = HandSites(RNG.integers(0, 5, count), RNG.integers(0, 4, count), RNG.normal(0, 0.02, (count, 3)))
    angles, step = random_angles(3), 1e-6
    posed = hand.pose(angles)
    jacobian = hand.site_jacobian(posed, sites, hand.sites(posed, sites), np.tile(np.eye(3), (len(angles), 1, 1)))
    for a in range(NUM_ANGLES):
        moved = [hand.sites(hand.pose(angles + s * step * np.eye(NUM_ANGLES)[a]), sites) for s in (-1, 1)]
        np.testing.assert_allclose(jacobian[..., a], (moved[1] - moved[0]) / (2 * step), atol=1e-8)


def test_both_sides_have_the_same_angles_where_they_are_mirror_images() -> None:
    left, right = (HandSkeleton.of_points(open_hand(side), side) for side in (0, 1))
    angles = random_angles(5)
    points = [hand.sites(hand.pose(angles), hand.keypoints()) for hand in (left, right)]
    np.testing.assert_allclose(points[0] * [-1, 1, 1], points[1], atol=1e-12)


@pytest.mark.parametrize("side", [0, 1])
def test_flexion_bends_into_the_palm_and_spread_towards_the_thumb(side: int) -> None:
    """The hand of the test lies palm down, y up, fingers along z; a left hand's thumb is at -x."""
    hand, thumb = HandSkeleton.of_points(open_hand(side), side), (-1.0, 1.0)[side]
    flat = np.zeros((1, NUM_ANGLES))
    tips = [i for i, name in enumerate(HAND_POINTS) if name.endswith("_tip")]

    def tip(name: str, finger: int) -> np.ndarray:
        angles = flat.copy()
        angles[0, ANGLES.index(name)] = 0.5
        points = [hand.sites(hand.pose(a), hand.keypoints())[0, tips[finger]] for a in (angles, flat)]
        return points[0] - points[1]

    for number, finger in enumerate(("index", "middle", "ring", "pinky"), 1):
        for joint in ("mcp", "pip", "dip"):
            assert tip(f"{finger}_{joint}_flexion", number)[1] < -0.005
        assert thumb * tip(f"{finger}_mcp_spread", number)[0] > 0.02
    away = tip("thumb_cmc_spread", 0)
    assert thumb * away[0] > 0.01
    assert away[1] < -0.01
    across = tip("thumb_cmc_flexion", 0)
    assert thumb * across[0] < -0.01
    assert across[1] < -0.01


def test_local_rotations_carry_the_points_of_a_body() -> None:
    """Posed as a body poses its tree: ``p_c = p_j + G_j (J_c - J_j)``."""
    hand = HandSkeleton.of_points(open_hand(1) + RNG.normal(0, 0.001, (21, 3)), 1)
    angles = random_angles(4)
    rest = hand.points_at_rest[1:].reshape(5, 4, 3)
    local = hand.local_rotations(angles)
    G, place = np.broadcast_to(np.eye(3), (4, 5, 3, 3)), np.broadcast_to(rest[:, 0], (4, 5, 3))
    found = [place]
    for joint in range(3):
        G = G @ local[:, :, joint]
        place = place + (G @ (rest[:, joint + 1] - rest[:, joint])[..., None])[..., 0]
        found.append(place)
    expected = hand.sites(hand.pose(angles), hand.keypoints())[:, 1:].reshape(4, 5, 4, 3)
    np.testing.assert_allclose(np.stack(found, axis=2), expected, atol=1e-12)


@pytest.mark.parametrize("side", [0, 1])
def test_angles_come_back_from_a_bodys_rotations(side: int) -> None:
    hand, angles = HandSkeleton.of_points(open_hand(side), side), random_angles(10)
    np.testing.assert_allclose(hand.angles_of(hand.local_rotations(angles)), angles, atol=1e-9)
