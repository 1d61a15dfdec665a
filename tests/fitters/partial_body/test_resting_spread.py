"""Ellipsoids of resting joints: turned with their anchor, and larger for trunk and legs where the pelvis leans."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.fitters.partial_body.resting_spread import (
    ARM_MOST_DEG,
    ARM_TILT_DEG,
    MOST_DEG,
    SPREAD_MM,
    TILT_DEG,
    with_resting_spread,
)
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.symmetric import unpacked
from solver_backend.types import SMPL_JOINTS

UPRIGHT = exp_so3(np.array([0.5 * np.pi, 0.0, 0.0]))
"""The body's up is the world's."""


def sigma_mm(lean_deg: float, part: str, joint: str) -> np.ndarray:
    """Return the deviations along the anchor's axes that a joint of a part at rest has, its anchor known exactly."""
    layout = load_body().layout.recorded
    turned = exp_so3(np.array([np.radians(lean_deg), 0.0, 0.0])) @ UPRIGHT
    G = np.broadcast_to(turned, (1, layout.num_joints, 3, 3))
    nothing = np.zeros((1, layout.num_joints, 6))
    found = unpacked(with_resting_spread(nothing, G, layout, {part: (joint,)}, {part: np.ones(1)}))
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
