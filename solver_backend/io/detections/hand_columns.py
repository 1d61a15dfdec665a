"""Hands among the columns of whole-body detectors, and what detectors write for a point that was not seen."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.hand_points import HAND_COLUMNS, NUM_HAND_POINTS
from solver_backend.io.recognition.confidence import on_unit_scale
from solver_backend.types import UNSEEN_POINT, JointSet


def hands_of(xy: np.ndarray, confidence: np.ndarray, joint_set: JointSet) -> np.ndarray | None:
    """Return the (..., 2, 21, 3) hands of whole bodies, left first; None where the joint set has none.

    Args:
        xy: (..., K, 2) pixels of all K keypoints that were written.
        confidence: (..., K).
        joint_set: what they are.
    """
    firsts = HAND_COLUMNS.get((joint_set, xy.shape[-2]))
    if firsts is None:
        return None
    columns = np.array(firsts)[:, None] + np.arange(NUM_HAND_POINTS)
    return cleaned_hands(np.concatenate([xy[..., columns, :], confidence[..., columns, None]], axis=-1))


def cleaned_hands(hands: np.ndarray) -> np.ndarray:
    """Return hands with confidences in 0..1 and unseen points (0, 0 or NaN) as NaN with confidence 0.

    Args:
        hands: (..., 2, 21, 3) as written.
    """
    unseen = np.isnan(hands).any(-1) | ~(hands[..., 2] > 0) | (hands[..., :2] == 0).all(-1)
    sure, _, _ = on_unit_scale(np.where(unseen, 0.0, hands[..., 2]))
    cleaned = np.concatenate([hands[..., :2], sure[..., None]], axis=-1).astype(np.float32)
    cleaned[unseen] = UNSEEN_POINT
    return cleaned
