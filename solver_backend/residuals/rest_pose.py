"""A weak pull of joints towards rest, for the turns that no keypoint sees (a wrist without hand points, toes)."""

from __future__ import annotations

import numpy as np
from array_api_compat import array_namespace

from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import SMPL_JOINTS

_SPREAD_RAD = {
    "spine1": 0.2, "spine2": 0.2, "spine3": 0.2, "neck": 0.3, "head": 0.4, "collar": 0.25, "shoulder": 1.2,
    "elbow": 1.2, "wrist": 0.25, "hip": 1.2, "knee": 1.2, "ankle": 0.4, "foot": 0.25,
}  # fmt: skip
"""Standard deviation of each joint's rotation about each axis in everyday motion."""


def rest_precision() -> np.ndarray:
    """Return the (21,) precision of joints 1..21, 1/rad²."""
    parts = [joint.removeprefix("left_").removeprefix("right_") for joint in SMPL_JOINTS[1:22]]
    return np.array([1.0 / _SPREAD_RAD[part] ** 2 for part in parts])


def rest_pose_term(local: Array) -> tuple[Array, Array, Array]:
    """Return cost (F,), gradient (F, 63) and the Hessian's diagonal (63,) by the joints' left tangents.

    ``E = 1/2 sum_j p_j |log R_j|²``; the left Jacobian leaves its own vector in place: the gradient is ``p_j log R_j``.

    Args:
        local: (F, 21, 3, 3) rotations of joints 1..21.
    """
    xp = array_namespace(local)
    precision = constant(rest_precision(), local)
    vector = log_so3(local)
    pull = precision[:, None] * vector
    cost = 0.5 * xp.sum(xp.sum(pull * vector, axis=-1), axis=-1)
    return cost, xp.reshape(pull, (local.shape[0], -1)), constant(np.repeat(rest_precision(), 3), local)
