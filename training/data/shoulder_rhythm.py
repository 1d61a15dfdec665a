"""Collar rotations for recordings whose collar bones do not move."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.rotations import exp_so3

_ARMS = ((13, 16, 1.0), (14, 17, -1.0))
"""(collar, shoulder, sign of x of the arm in the T-pose); columns of SMPL's 21 body joints are these less one."""
RAISING_SHARE = 0.22
"""Part of the upper arm's elevation above the horizontal that the collar takes."""
REACHING_SHARE = 0.15
"""Part of the upper arm's forward swing that the collar takes."""


def with_shoulder_rhythm(rotations: np.ndarray) -> np.ndarray:
    """Return poses whose collars follow the arms, each upper arm keeping its direction in the chest's frame.

    The collar turns by 0.22 of the arm's elevation about z and by 0.15 of its forward swing about y (times the cosine
    of the elevation, as an upright arm has no swing); the shoulder takes the rest.

    Args:
        rotations: (F, 21, 3, 3) local rotations of the body joints.

    Returns:
        (F, 21, 3, 3).

    Reference: after the scapulohumeral rhythm of Inman, Saunders & Abbott 1944; shares chosen for the T-pose as zero.
    """
    out = rotations.copy()
    for collar, shoulder, side in _ARMS:
        arm = rotations[:, collar - 1] @ rotations[:, shoulder - 1]
        along = side * arm[:, :, 0]
        elevation = np.arcsin(np.clip(along[:, 1], -1.0, 1.0))
        swing = np.arctan2(along[:, 2], np.abs(along[:, 0])) * np.cos(elevation)
        turn = np.stack((0 * swing, -side * REACHING_SHARE * swing, side * RAISING_SHARE * elevation), axis=-1)
        out[:, collar - 1] = exp_so3(turn)
        out[:, shoulder - 1] = np.swapaxes(out[:, collar - 1], -1, -2) @ arm
    return out
