"""The largest person of each picture, in frames in which most views see somebody, to try a calibration on."""

from __future__ import annotations

import numpy as np

from solver_backend.people.detections import Detections
from solver_backend.people.sightings import MIN_CONFIDENCE, MIN_POINTS, compared_keypoints

_FRAMES = 40
"""Frames that are looked at, spread over the take."""


def main_person(detections: Detections, *, every_keypoint: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return xy (C, F, J, 2) px and confidence (C, F, J) of the largest person in each picture.

    Args:
        detections: everybody.
        every_keypoint: return all keypoints, not only those that every detector finds (``compared_keypoints``).
    """
    columns, _ = compared_keypoints(detections.joint_set)
    kept = np.arange(detections.xy.shape[3]) if every_keypoint else columns
    xy, confidence = detections.xy[..., columns, :].astype(np.float64), detections.confidence[..., columns]
    seen = confidence >= MIN_CONFIDENCE
    low = np.where(seen[..., None], xy, np.inf).min(-2)
    high = np.where(seen[..., None], xy, -np.inf).max(-2)
    size = np.where(seen.sum(-1) >= MIN_POINTS, np.linalg.norm(np.where(high > low, high - low, 0.0), axis=-1), -1.0)
    largest = size.argmax(-1)[..., None, None]
    xy, confidence = detections.xy[..., kept, :].astype(np.float64), detections.confidence[..., kept]
    confidence = np.take_along_axis(confidence, largest, axis=2)[:, :, 0]
    return np.take_along_axis(xy, largest[..., None], axis=2)[:, :, 0], confidence


def well_seen_frames(confidence: np.ndarray) -> np.ndarray:
    """Return up to ``_FRAMES`` frames in which most views see somebody, from confidence (C, F, J)."""
    views = ((confidence >= MIN_CONFIDENCE).sum(-1) >= MIN_POINTS).sum(0)
    good = np.flatnonzero((views >= 2) & (views == views.max(initial=0)))
    return good[np.unique(np.linspace(0, len(good) - 1, min(len(good), _FRAMES)).astype(int))] if len(good) else good
