"""Fingers keep out of one another: a penalty on capsules about their bones that overlap more than skin gives way."""

from __future__ import annotations

import numpy as np

from solver_backend.body.finger_overlap import BONES, PAIRS, finger_gaps
from solver_backend.types.shapes import Float

GIVES_WAY_M = 0.002
"""Overlap that costs nothing: skin of fingers that lie side by side."""
SIGMA_M = 0.001
"""Standard deviation of what is beyond it: half of what the breadth of fingers differs by between people, so that
detections which contradict each other do not press fingers together."""


def contact_equations(
    points: Float[np.ndarray, "n 21 3"], jacobian: Float[np.ndarray, "n 21 3 d"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return costs (n,), gradients (n, D) and Gauss-Newton matrices (n, D, D) of ``½ Σ max(depth - δ, 0)² / σ²``.

    The way between two bones changes as their nearest points do, which move along the bones without a first-order
    effect.

    Args:
        points: (n, 21, 3) metres of ``HAND_POINTS``.
        jacobian: (n, 21, 3, D) of them by the state.
    """
    count, dof = len(points), jacobian.shape[-1]
    cost, gradient, hessian = np.zeros(count), np.zeros((count, dof)), np.zeros((count, dof, dof))
    gaps = finger_gaps(points)
    frame, pair = np.nonzero(gaps.depth > GIVES_WAY_M)
    if not len(frame):
        return cost, gradient, hessian
    over = (gaps.depth[frame, pair] - GIVES_WAY_M) / SIGMA_M
    apart = gaps.apart[frame, pair]
    normal = apart / np.maximum(np.linalg.norm(apart, axis=-1, keepdims=True), 1e-6)
    moved = np.zeros((len(frame), 3, dof))
    for which, sign in enumerate((1.0, -1.0)):
        share = gaps.along[frame, pair, which, None, None]
        first, last = BONES[PAIRS[which][pair]].T
        moved += sign * ((1.0 - share) * jacobian[frame, first] + share * jacobian[frame, last])
    rows = -(normal[:, None] @ moved)[:, 0] / SIGMA_M
    np.add.at(cost, frame, 0.5 * over**2)
    np.add.at(gradient, frame, over[:, None] * rows)
    np.add.at(hessian, frame, rows[:, :, None] * rows[:, None])
    return cost, gradient, hessian
