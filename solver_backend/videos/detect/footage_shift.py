"""Footage that is some frames late of the detections: hands in it are where detections had the wrists."""

from __future__ import annotations

import numpy as np

from solver_backend.types.shapes import Float

REACH = 5
"""Frames by which footage is off at most: further off, hands are not at the wrists they are looked for."""
LEAST_FRAMES = 20
"""Frames that show a hand and its wrist; chosen by hand."""
SURE = 0.3
"""Confidence from which a wrist counts; chosen by hand."""
MOVES = 0.5
"""Hands move enough where their errors at the best shift are less than this share of those at the worst one. By
``python -m tests.benchmarks.hands.late_footage``: no shift of hands that rest is invented up to 0.7, 7 of 16 at 1.0; of
112 known shifts 1 is wrong at 0.3, 5 at 0.5 and 6 at 0.7, and 26, 11 and 6 are missed."""
AGREE = 0.75
"""Share of the hands of all views that must be nearer to their wrists with the shift than without. By the same command:
at 0.9 twice as many shifts are missed and as many are wrong, at 0.5 four fewer are missed and one more is wrong."""


def footage_shift(
    hands: Float[np.ndarray, "views frames 2 21 3"], wrists: Float[np.ndarray, "views frames 2 3"]
) -> int:
    """Return by how many pictures the footage is late of the detections; 0 where hands do not show it.

    ``Σ |h_f - w_(f - d) - median|² / s²`` over the hands of all views, s their size, is least at some shift d, between
    frames by a parabola. What is constant is the detectors' own difference.

    Args:
        hands: (C, F, 2, 21, 3) px and confidence, found in the picture of each frame.
        wrists: (C, F, 2, 3) px and confidence, of the detections, left first.
    """
    each = [_errors(hands[view, :, side], wrists[view, :, side]) for view in range(len(hands)) for side in (0, 1)]
    errors = np.array([found for found in each if found is not None])
    if len(errors) < 2:
        return 0
    total = errors.sum(axis=0)
    best = int(np.argmin(total))
    if not 0 < best < len(total) - 1 or total[best] > MOVES * total.max():
        return 0
    before, least, after = total[best - 1 : best + 2]
    shift = round(best - REACH + 0.5 * (before - after) / max(before - 2.0 * least + after, 1e-12))
    nearer = errors[:, REACH + shift] < errors[:, REACH]
    return shift if nearer.mean() >= AGREE else 0


def in_time(hands: Float[np.ndarray, "views frames 2 21 3"], shift: int) -> Float[np.ndarray, "views frames 2 21 3"]:
    """Return hands by the frames of the detections, unseen where the footage has no picture of one.

    Args:
        hands: (C, F, 2, 21, 3) by the picture.
        shift: pictures by which the footage is late.
    """
    moved = np.full_like(hands, np.nan)
    moved[..., 2] = 0.0
    count = hands.shape[1] - abs(shift)
    moved[:, max(-shift, 0) :][:, :count] = hands[:, max(shift, 0) :][:, :count]
    return moved


def _errors(hand: np.ndarray, wrist: np.ndarray) -> np.ndarray | None:
    """Return how far a hand (F, 21, 3) is from its wrist (F, 3) at each shift, None where too few frames show both."""
    frames = np.flatnonzero(hand[:, 0, 2] > 0)
    frames = frames[(frames >= REACH) & (frames < len(hand) - REACH)]
    if len(frames) < LEAST_FRAMES:
        return None
    length = float(np.median(np.linalg.norm(hand[frames, 1:, :2] - hand[frames, :1, :2], axis=-1).max(axis=1)))
    errors = np.zeros(2 * REACH + 1)
    for number, shift in enumerate(range(-REACH, REACH + 1)):
        there = wrist[frames - shift]
        sure = there[:, 2] >= SURE
        if sure.sum() < LEAST_FRAMES:
            return None
        apart = hand[frames[sure], 0, :2] - there[sure, :2]
        apart -= np.median(apart, axis=0)
        # One wild detection counts no more than a hand's length.
        errors[number] = (
            np.minimum((apart**2).sum(axis=1) / max(length, 1.0) ** 2, 1.0).sum() * len(frames) / sure.sum()
        )
    return errors
