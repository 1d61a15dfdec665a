"""Ellipsoids of resting joints: turned with their anchor, and larger for trunk and legs where the pelvis leans."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.fitters.rest_parts import (
    ARM_MOST_DEG,
    ARM_TILT_DEG,
    BESIDE_MM,
    MOST_DEG,
    SPREAD_MM,
    TILT_DEG,
    growth,
    stance,
    with_resting_spread,
)
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.types import SMPL_JOINTS

UPRIGHT = exp_so3(np.array([0.5 * np.pi, 0.0, 0.0]))  # The body's up is the world's.


def sigma_mm(lean_deg: float, part: str, joint: str) -> np.ndarray:
    """Return the deviations along the anchor's axes that a joint of a part at rest has, its anchor known exactly."""
    layout = load_body().layout.recorded
    turned = exp_so3(np.array([np.radians(lean_deg), 0.0, 0.0])) @ UPRIGHT
    G = np.broadcast_to(turned, (1, layout.num_joints, 3, 3))
    nothing = np.zeros((1, layout.num_joints, 6))
    shown = stance(G[:, 0], np.zeros((1, 3)), 30.0)
    found = unpacked(with_resting_spread(nothing, G, shown, layout, {part: (joint,)}, {part: np.ones(1)}))
    own = turned.T @ found[0, SMPL_JOINTS.index(joint)] @ turned
    assert np.abs(own - np.diag(np.diag(own))).max() < 1e-12
    return 1000 * np.sqrt(np.diag(own))


@pytest.mark.parametrize(
    ("part", "joint", "anchor", "factors"),
    [
        ("trunk", "spine3", "pelvis", (1.0, 2.0, 1.0 + MOST_DEG / TILT_DEG)),
        ("left_thigh", "left_knee", "pelvis", (1.0, 2.0, 1.0 + MOST_DEG / TILT_DEG)),
        ("left_shank", "left_foot", "hip", (1.0, 2.0, 1.0 + MOST_DEG / TILT_DEG)),
        ("left_upper_arm", "left_wrist", "spine3", (1.0, 1.0, 1.0 + ARM_MOST_DEG / ARM_TILT_DEG)),
        ("trunk", "left_wrist", "pelvis", (1.0, 1.0, 1.0 + ARM_MOST_DEG / ARM_TILT_DEG)),
        ("head", "head", "spine3", (1.0, 1.0, 1.0)),
    ],
)  # fmt: skip
def test_spread_grows_with_the_lean_of_the_pelvis(
    part: str, joint: str, anchor: str, factors: tuple[float, ...]
) -> None:
    table = np.array(SPREAD_MM[anchor][joint.removeprefix("left_")], dtype=float)
    for lean, factor in zip((0.0, TILT_DEG, 150.0), factors, strict=True):
        np.testing.assert_allclose(sigma_mm(lean, part, joint), factor * table, rtol=1e-6)


def test_what_is_beside_a_resting_part_is_less_sure() -> None:
    for part, joint, millimetres in (("trunk", "spine1", 20.0), ("left_thigh", "right_hip", 9.5)):
        sigma = sigma_mm(0.0, part, joint)
        np.testing.assert_allclose(sigma, BESIDE_MM[part.removeprefix("left_")][joint.removeprefix("right_")])
        assert sigma[0] == pytest.approx(millimetres, rel=0.5)
    assert not sigma_mm(0.0, "left_shank", "left_hip").any()


def test_who_walks_has_arms_nearer_to_their_rest_and_who_squats_legs_farther() -> None:
    places = np.zeros((90, 3))
    places[:, 0] = np.clip(np.arange(90) - 30, 0, 30) / 30.0 * 1.5  # walks in the middle second, then squats
    places[60:, 2] = -0.3
    shown = stance(np.broadcast_to(UPRIGHT, (90, 3, 3)), places, 30.0)
    walking, low = shown.walking, shown.low
    assert walking[45] == 1.0 and not walking[[10, 80]].any() and low[80] == 1.0 and not low[:60].any()
    assert 0.3 < growth(shown, "spine3", "wrist")[45] < 0.9 and growth(shown, "pelvis", "wrist")[80] == 1.0
    assert growth(shown, "pelvis", "knee")[80] > 1.2 and growth(shown, "spine3", "head")[45] == 1.0
    far = stance(np.broadcast_to(UPRIGHT, (90, 3, 3)), places + [50.0, -20.0, 900.0], 30.0)
    assert all(np.allclose(a, b) for a, b in zip(vars(shown).values(), vars(far).values(), strict=True))
