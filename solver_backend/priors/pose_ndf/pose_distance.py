"""How far two poses are apart: the weighted geodesic distance of their joints' quaternions (Tiwari et al. 2022)."""

from __future__ import annotations

import numpy as np
from array_api_compat import array_namespace

from solver_backend.body.kinematics import subtree_matrix
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_PARENTS
from solver_backend.geometry.arrays import Array, constant


def _joint_weights() -> np.ndarray:
    below = subtree_matrix(SMPL_PARENTS).sum(axis=1)[1 : 1 + NUM_BODY_JOINTS]
    return np.sqrt(below) / np.sqrt(below).mean()


JOINT_WEIGHTS: np.ndarray = _joint_weights()
"""(21,) weights ``w`` of the joints 1..21, mean 1: the root of the number of joints that a joint moves, itself counted.
The paper states only that joints early in the chain weigh more."""


TURN_METRIC: np.ndarray = JOINT_WEIGHTS / 8.0
"""(21,) factors of the squared distance between a pose and the same turned a little: ``d² = Σ_k w_k/8 |ω_k|²``."""


def pose_distance(a: Array, b: Array) -> Array:
    """Return ``d(a, b) = sqrt(Σ_k w_k/2 arccos²|a_k · b_k|)``, the same for q and -q; rad.

    Args:
        a: (..., 21, 4) unit quaternions.
        b: (..., 21, 4) unit quaternions, broadcast against ``a``.

    Returns:
        (...).

    Reference: Tiwari et al. 2022, "Pose-NDF", eq. 2.
    """
    xp = array_namespace(a, b)
    angle = half_angles(a, b)
    return xp.sqrt(xp.sum(0.5 * constant(JOINT_WEIGHTS, a) * angle * angle, axis=-1))


def half_angles(a: Array, b: Array) -> Array:
    """Return ``arccos|a · b| = 2 arcsin(min|a ∓ b|/2)``, half the angle between; (..., 4) -> (...) rad."""
    xp = array_namespace(a, b)
    near, far = xp.sum((a - b) ** 2, axis=-1), xp.sum((a + b) ** 2, axis=-1)
    return 2.0 * xp.asin(0.5 * xp.sqrt(xp.where(near < far, near, far)))
