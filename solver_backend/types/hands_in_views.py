"""Hands that views show beside a body's keypoints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.exchange.errors import KeypointCountMismatch, NonFiniteData
from solver_backend.exchange.hand_points import HAND_POINTS, NUM_HAND_POINTS, SIDES
from solver_backend.exchange.plausible import FARTHEST_PX

UNSEEN_POINT = (np.nan, np.nan, 0.0)
"""x, y and confidence of a point that was not seen."""


def stacked_hands(hands: Sequence[np.ndarray | None], axis: int) -> np.ndarray | None:
    """Return the hands of several people side by side, NaN of people without; None where nobody has any."""
    like = next((hand for hand in hands if hand is not None), None)
    if like is None:
        return None
    return np.stack([np.full_like(like, np.nan) if hand is None else hand for hand in hands], axis=axis)


def checked_hands(hands: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return hands whose unseen points are NaN with confidence 0.

    Raises:
        KeypointCountMismatch: they are of other views or frames, or of another number of points.
        NonFiniteData: one is infinite or beyond any picture.
    """
    hands = np.array(hands, dtype=np.float64)
    expected = (*shape, 2, NUM_HAND_POINTS, 3)
    if hands.shape != expected:
        raise KeypointCountMismatch(f"The hands have the shape {hands.shape}; {expected} is expected.")
    beyond = (np.abs(hands) > FARTHEST_PX).any(-1)
    if beyond.any():
        view, frame, hand, point = np.argwhere(beyond)[0]
        raise NonFiniteData(
            "A point of a hand is infinite or beyond any picture.",
            where=f"view {view}, frame {frame}, {SIDES[hand]} {HAND_POINTS[point]}",
            hint="Write NaN (or 0 0 0) for a point that was not seen.",
        )
    hands[~np.isfinite(hands).all(-1) | ~(hands[..., 2] > 0)] = UNSEEN_POINT
    return hands
