"""Where the solve of a hand begins: located points, the size of the hand, and keys that are near them."""

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
SIZES = (0.75, 1.35)
"""Least and largest hands, as shares of the body's own: four standard deviations of hands of one stature."""
LEAST_BONES = 60
"""Measured bones that determine a size: a second or so of a palm."""
LEAST_EACH = 3
"""Frames in which a bone must be measured to count."""
FARTHEST_M = 0.08
"""No wrist starts further from where the body has it."""


def hand_size(
    skeleton: HandSkeleton, points: Float[np.ndarray, "frames 21 3"], spread: Float[np.ndarray, "frames 21"]
) -> float:
    """Return how many times the skeleton's the bones of located points are; 1 where too few are known.

    ``s² = Σ_b median_f(|d_bf|² - v_bf) / Σ_b L_b²``: noise makes a bone look longer by its variance v, by a quarter
    for a finger's bone of 25 mm between points that are 10 mm off.

    Args:
        skeleton: of the size that the body's shape gives it.
        points: (F, 21, 3) metres, NaN where a point is not located.
        spread: (F, 21) m², trace of the covariance by which points scatter about their hand.
    """
    square, rest = _square_bones(points), _square_bones(skeleton.points_at_rest[None])[0]
    known = np.isfinite(square)
    if known.sum() < LEAST_BONES:
        return 1.0
    each = square - _sum_at_bones(spread)
    enough = np.flatnonzero(known.sum(axis=0) >= LEAST_EACH)
    found = sum(float(np.median(each[known[:, b], b])) for b in enough)
    return float(np.clip(np.sqrt(max(found, 0.0) / rest[enough].sum()), *SIZES)) if len(enough) else 1.0


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


def _square_bones(points: np.ndarray) -> np.ndarray:
    """Return (F, 19) squared lengths: wrist to knuckles, and the bones of the fingers."""
    chain = points[:, 1:].reshape(len(points), 5, 4, 3)
    palm = ((chain[:, 1:, 0] - points[:, :1]) ** 2).sum(-1)
    bones = (np.diff(chain, axis=2) ** 2).sum(-1)
    return np.concatenate([palm, bones.reshape(len(points), -1)], axis=1)


def _sum_at_bones(values: np.ndarray) -> np.ndarray:
    """Return (F, 19) sums of (F, 21) values at the ends of the same bones."""
    chain = values[:, 1:].reshape(len(values), 5, 4)
    palm = chain[:, 1:, 0] + values[:, :1]
    return np.concatenate([palm, (chain[:, :, 1:] + chain[:, :, :-1]).reshape(len(values), -1)], axis=1)
