"""The size that a calibration starts at: a child's markers fitted to an adult crouch, and their knees end elsewhere."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.markers import ON_BONE
from solver_backend.geometry.quantiles import quantile

OTHER_SIZE = 0.12
"""Logarithm of the size from which it counts: below 1.50 and above 1.91 m for a mean stature of 1.69 m. A walk of
somebody of 1.36 m ends 42 mm off from the mean body, and of 1.09 m 61 mm."""
LEAST_M, LEAST_SUM_M = 0.12, 0.6
"""Distance at rest of a pair that shows size, as markers are centimetres beside their places, and of all together: two
shanks are enough."""
AT_JOINT_M = 0.07
"""A marker so near a joint keeps its distance from those of both bones that meet there."""
SPREAD_M = 0.03
"""How far joints are from those of the mean body at another size, against a deviation of each shape coefficient."""


def first_shape(body: Body, landmarks: Landmarks, points: np.ndarray) -> np.ndarray:
    """Return (10,) the shape to start at: that of the mean body at the markers' size, 0 where they show no other.

    The size is the median of ``d / r``, weighed by r, over pairs of markers that keep their distance in any pose: d as
    recorded, r of the mean body. The shape is ``argmin |D b - (s - 1) J|² / SPREAD_M² + |b|²`` with joints J and their
    derivatives D, both from the pelvis.

    Args:
        body: whose shapes count.
        landmarks: L places of the markers.
        points: (F, L, 3) metres, NaN where missing.
    """
    nothing = np.zeros(body.joints_shapedirs.shape[-1])
    rest = landmarks.anchors.sum(axis=1)
    one, other = np.nonzero(np.triu(_keeps_distance(body, landmarks, rest), 1))
    at_rest = np.linalg.norm(rest[one] - rest[other], axis=-1)
    apart = quantile(np.linalg.norm(points[:, one] - points[:, other], axis=-1), 0.5, axis=0)
    shown = (at_rest >= LEAST_M) & np.isfinite(apart)
    if at_rest[shown].sum() < LEAST_SUM_M:
        return nothing
    ratio, weight = (apart / np.maximum(at_rest, 1e-9))[shown], at_rest[shown]
    order = np.argsort(ratio)
    size = ratio[order][np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)]
    if not abs(np.log(max(size, 1e-6))) >= OTHER_SIZE:
        return nothing
    J = (body.joints_template - body.joints_template[0]).ravel()
    D = (body.joints_shapedirs - body.joints_shapedirs[0]).reshape(len(J), -1)
    return np.linalg.solve(D.T @ D + SPREAD_M**2 * np.eye(len(nothing)), D.T @ ((size - 1) * J))


def _keeps_distance(body: Body, landmarks: Landmarks, rest: np.ndarray) -> np.ndarray:
    """Return (L, L) whether two markers are on one bone: their own, or both that meet at a joint beside them."""
    joints = np.arange(len(body.parents))
    at_joint = np.linalg.norm(rest[:, None] - body.joints_template, axis=-1) < AT_JOINT_M
    above = joints[:, None] == np.maximum(body.parents, 0)  # (bone, joint that it leads to)
    carried = (landmarks.weights.argmax(axis=1)[:, None] == joints) | at_joint | (at_joint @ above.T)
    placed = np.array([not name.startswith(ON_BONE) for name in landmarks.names])
    return (carried @ carried.T) & placed[:, None] & placed
