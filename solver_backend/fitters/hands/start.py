"""Where the solve of a hand begins: keys that are near its located points."""

from __future__ import annotations

import numpy as np

from solver_backend.body.hand_angles import KNUCKLES, measure_angles
from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.fitters.hands.hand_keys import DOF, FINGERS, SHIFT, TURN
from solver_backend.fitters.hands.hand_problem import WristPath
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.hand_prior import HandPrior
from solver_backend.types.shapes import Float

PALM = (0, 1, *KNUCKLES[1:])
"""Points of the palm: wrist, root of the thumb and knuckles."""
LEAST_PALM = 4
"""Points of the palm that place it."""
FARTHEST_M = 0.08
"""No wrist starts further from where the body has it."""


def initial_keys(
    skeleton: HandSkeleton, wrist: WristPath, points: np.ndarray, layout: KeyframeLayout, prior: HandPrior
) -> Float[np.ndarray, "keys d"]:
    """Return (K, D) keys: means in time of the turns and angles that located points show, else the relaxed hand.

    Args:
        skeleton: the hand.
        wrist: where the body has its wrist.
        points: (F, 21, 3) metres, NaN where a point is not located.
        layout: of the keys.
        prior: of hands.
    """
    frames = np.arange(len(points))
    spacing = max(1.0, float(np.diff(layout.key_times).mean()))
    near = np.exp(-0.5 * ((layout.key_times[:, None] - frames) / (0.5 * spacing)) ** 2)
    turns, located = palm_turns(skeleton, points)
    relative = np.where(located[:, None, None], turns @ np.swapaxes(wrist.rotations, 1, 2), 0.0)
    # What no frame near by shows is taken from those further off, the sooner the nearer.
    far = near + 1e-3 / (1.0 + np.abs(layout.key_times[:, None] - frames) / spacing) ** 2
    mean = (far @ relative.reshape(len(points), 9)).reshape(-1, 3, 3) + 1e-6 * np.eye(3)
    keys = np.zeros((layout.num_keys, DOF))
    keys[:, TURN] = log_so3(nearest_rotations(mean))
    angles = np.clip(measure_angles(points, skeleton.side), prior.low, prior.high)
    keys[:, FINGERS] = _means(near, angles, prior.mean)
    shift = points[:, 0] - wrist.places
    close = np.linalg.norm(shift, axis=1) < FARTHEST_M
    keys[:, SHIFT] = _means(near, np.where(close[:, None], shift, np.nan), np.zeros(3))
    return keys


def palm_turns(skeleton: HandSkeleton, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (F, 3, 3) rotations from rest to the world that fit the palm (Kabsch 1976), and (F,) where located."""
    palm, rest = points[:, PALM], skeleton.points_at_rest[list(PALM)]
    seen = np.isfinite(palm).all(-1)
    located = (seen.sum(1) >= LEAST_PALM) & seen[:, 0]
    weight = (seen & located[:, None])[..., None]
    count = np.maximum(weight.sum(1, keepdims=True), 1)
    here = np.where(weight, palm, 0.0)
    there = np.where(weight, rest, 0.0)
    here = np.where(weight, here - here.sum(1, keepdims=True) / count, 0.0)
    there = np.where(weight, there - there.sum(1, keepdims=True) / count, 0.0)
    return nearest_rotations(np.swapaxes(here, 1, 2) @ there + 1e-12 * np.eye(3)), located


def _means(near: np.ndarray, values: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return (K, d) means over time of (F, d) values that may be NaN; what hardly any frame shows is otherwise."""
    known = np.isfinite(values)
    weight, least = near @ known, 0.1
    return (near @ np.where(known, values, 0.0) + least * otherwise) / (weight + least)


def nearest_rotations(matrices: np.ndarray) -> np.ndarray:
    """Return the (n, 3, 3) rotations nearest to matrices."""
    U, _, V_T = np.linalg.svd(matrices)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ V_T))[..., None]
    return U @ V_T
