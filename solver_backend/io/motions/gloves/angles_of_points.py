"""Angles of points of a hand whose axes may be left-handed: fingers bend into the palm."""

from __future__ import annotations

import numpy as np

from solver_backend.body.hand_angles import ANGLES, KNUCKLES
from solver_backend.body.skeleton_fingers import finger_angles
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.types.shapes import Float

_BENDS = np.array([name.endswith(("pip_flexion", "dip_flexion")) and not name.startswith("thumb") for name in ANGLES])
"""Joints that bend one way only."""
_MIRROR = np.array([-1.0, 1.0, 1.0])
_LEAST_PALM = 1e-6
"""Of any unit: the wrist's distance from the knuckles."""


def angles_of_points(
    points: Float[np.ndarray, "frames 21 3"], side: int, where: str
) -> tuple[Float[np.ndarray, "frames a"], Float[np.ndarray, "frames 3 3"]]:
    """Return angles (F, A), radians, and rotations of the palm (F, 3, 3) of a hand's points in any axes.

    Mirrored points bend fingers towards the back of the hand, which people cannot: they are mirrored again.

    Args:
        points: (F, 21, 3) of ``HAND_POINTS`` in any unit; NaN where missing.
        side: 0 left, 1 right.
        where: for the error.

    Raises:
        MotionInvalid: the points of the palm are one, or missing.
    """
    palm = np.linalg.norm(points[:, KNUCKLES[1:]] - points[:, :1], axis=-1)
    if not (palm[:, [0, 1, -1]] > _LEAST_PALM).all(axis=1).any():
        raise MotionInvalid("The points of the palm are missing.", where=where, hint="Export positions of all joints.")
    angles, palms = finger_angles(points, side)
    if np.nansum(angles[:, _BENDS]) < 0:
        angles, palms = finger_angles(_MIRROR * points, side)
    return angles, palms
