"""The floor under an imported motion, and when the feet stand on it."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.joint_sets import NUM_JOINTS

_FEET = ((7, 10), (8, 11))
"""Ankle and ball of each foot."""
_LOWEST_SHARE = 2.0
"""Percentile of the frames' lowest soles that is the floor: single frames may lie deeper."""
_NEAR_M, _STILL_M_S = 0.04, 0.3
"""Height of a standing ball of the foot over its height at rest, and its speed, at most."""


def floor_height(body: Body, betas: np.ndarray, joints: np.ndarray) -> float:
    """Return the height in metres at which the lowest soles stand.

    A sole is below ankle and ball by what the shaped body at rest has there; a foot that stands has both down.

    Args:
        body: the body.
        betas: (10,) its shape.
        joints: (F, 24, 3) in the world.
    """
    above = _rest_heights(body, betas)
    lowest = np.min([joints[:, joint, 2] - above[joint] for foot in _FEET for joint in foot], axis=0)
    return float(np.percentile(lowest, _LOWEST_SHARE))


def standing_feet(body: Body, betas: np.ndarray, joints: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, 2) bool: left and right ball of the foot are down and still, the floor at z = 0."""
    balls = joints[:, [foot[1] for foot in _FEET]]
    heights = _rest_heights(body, betas)[[foot[1] for foot in _FEET]]
    if len(balls) < 2:
        return balls[..., 2] < heights + _NEAR_M
    speed = np.linalg.norm(np.gradient(balls, axis=0), axis=-1) * fps
    return (balls[..., 2] < heights + _NEAR_M) & (speed < _STILL_M_S)


def _rest_heights(body: Body, betas: np.ndarray) -> np.ndarray:
    vertices = body.v_template + body.shapedirs @ betas
    return body.rest_joints(betas)[:NUM_JOINTS, 1] - vertices[:, 1].min()
