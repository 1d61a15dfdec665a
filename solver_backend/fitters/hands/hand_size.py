"""How large a person's hands are: bones of located points, as far as they can be trusted, and people of that build."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from solver_backend.body.hand_skeleton import HandSkeleton
from solver_backend.types.shapes import Float

USUAL = 0.036
"""Standard deviation of the lengths of hands of people of one stature and forearm, as a share (ANSUR II)."""
SIZES = (0.75, 1.35)
"""Least and largest hands, as shares of the body's own: seven standard deviations; another size is a fault."""
LEAST_BONES = 60
"""Measured bones that determine a size: a second or so of a palm."""
LEAST_EACH = 3
"""Frames in which a bone must be measured to count."""
NOISE_OFF = 0.3
"""Share by which the variance that is subtracted may be wrong for all bones alike; what is constant in a view's errors
is not seen in it. Noises of drawn hands are measured to 25 % (tests/fitters/hands/test_hand_view_term.py)."""


@dataclass(frozen=True)
class HandSize:
    """Size of a hand as a share of the one that the body's shape gives it."""

    scale: float
    """As measured; 1 where too little is."""
    sigma: float
    """Its standard deviation; infinite where too little is measured."""


def hand_size(
    skeleton: HandSkeleton, points: Float[np.ndarray, "frames 21 3"], spread: Float[np.ndarray, "frames 21"]
) -> HandSize:
    """Return how many times the skeleton's the bones of located points are.

    ``s² = Σ_b L_b² median_f(|d_bf|² - v_bf) / Σ_b L_b⁴``, least squares where all squares are as far off: noise
    makes a bone look longer by its variance v, by a quarter for a finger's bone of 25 mm between points that are 10 mm
    off. How sure that is shows in how well bones agree, and in how much was subtracted.

    Args:
        skeleton: of the size that the body's shape gives it.
        points: (F, 21, 3) metres, NaN where a point is not located.
        spread: (F, 21) m², trace of the covariance by which points scatter about their hand.
    """
    square, rest = _square_bones(points), _square_bones(skeleton.points_at_rest[None])[0]
    known = np.isfinite(square)
    enough = np.flatnonzero(known.sum(axis=0) >= LEAST_EACH)
    if known.sum() < LEAST_BONES or not len(enough):
        return HandSize(1.0, np.inf)
    noise = _sum_at_bones(spread)
    each = np.array([np.median((square - noise)[known[:, b], b]) for b in enough])
    lost = np.array([np.median(noise[known[:, b], b]) for b in enough])
    own = rest[enough] / (rest[enough] ** 2).sum()
    scale = float(np.clip(np.sqrt(max(float(own @ each), 0.0)), *SIZES))
    apart = np.linalg.norm(own * (each - scale**2 * rest[enough]))
    return HandSize(scale, float(np.hypot(apart, NOISE_OFF * (own @ lost))) / (2.0 * scale))


def likely_size(hands: Iterable[HandSize]) -> float:
    """Return the size of a person's hands that is likeliest: ``(Σ s / σ² + 1 / σ₀²) / (Σ 1 / σ² + 1 / σ₀²)``.

    Args:
        hands: each as it was measured.
    """
    known = [(1.0, USUAL**-2), *((hand.scale, hand.sigma**-2) for hand in hands)]
    return float(sum(scale * weight for scale, weight in known) / sum(weight for _, weight in known))


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
