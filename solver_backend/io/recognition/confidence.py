"""Convert confidences to the range 0 to 1, and detections to pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.reading import LEAST_VALUES, Detections
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.io.recognition.joint_sets import SAMPLED_PEOPLE

PER_CENT, FLAGGED = 100.0, 2.0  # Value of certainty in percentages, and in COCO's flags (1 hidden, 2 visible).
_LOW, _HIGH, _SURE = 0.5, 1.5, 0.95
"""Confidences are relative if their quantile (third value) is outside the first two values. It then counts as 1."""
_TYPICAL_PER_CENT = 10.0  # Percentages typically exceed this. Other scores above 1 reach only a few units.


def on_unit_scale(confidence: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return confidences in 0..1, rescaled from other scales, notes and problems.

    Args:
        confidence: confidences of one joint set and take, in any shape. 0 or NaN means undetected.
    """
    confidence = np.where(np.isnan(confidence), 0.0, confidence).astype(confidence.dtype)
    seen, largest = confidence[confidence > 0], float(confidence.max(initial=0.0))
    if not len(seen):
        return confidence, (), ()
    few = len(seen) < LEAST_VALUES
    sure = float(np.quantile(seen, 0.5 if few else _SURE))
    if largest <= 1 and (few or sure >= _LOW):
        return confidence, (), ()
    if largest == FLAGGED and np.isin(seen, (1.0, FLAGGED)).all():
        how, certain = "flags", FLAGGED
    elif float(np.median(seen)) > _TYPICAL_PER_CENT and sure <= PER_CENT:  # a few scores may be larger
        how, certain = "percent", PER_CENT
    else:
        how, certain = ("above", 1.0) if largest > 1 and sure <= _HIGH else ("relative", sure)
    scaled = np.minimum(confidence / certain, 1.0)
    if how in ("above", "flags"):
        return scaled, (diagnostic("confidence_rescaled", how=how, severity=Severity.NOTE, largest=largest),), ()
    return scaled, (), (diagnostic("confidence_rescaled", how=how, largest=largest),)


def from_logarithms(confidence: np.ndarray, written: np.ndarray) -> np.ndarray:
    """Convert log-confidences to confidences if nearly all points are below 0.

    A single repeated negative value only marks undetected points. Logarithms are never above 0.
    """
    below, known = confidence[(confidence < 0) & written], written & np.isfinite(confidence)
    is_logarithm = len(below) >= max(LEAST_VALUES, _SURE * known.sum())
    is_logarithm = is_logarithm and bool((below != below[0]).any()) and not (confidence[known] > 0).any()
    return np.where(known, np.exp(np.minimum(confidence, 0.0)), 0.0) if is_logarithm else confidence


_LEAST_SHARE = 0.01  # Smallest fraction of all points at one position.
_MOST_KEYPOINTS = 0.5
"""Smallest fraction of keypoints that are ever at the position. A body has only one keypoint at a position."""


def placeholder(xy: np.ndarray, confidence: np.ndarray) -> np.ndarray | None:
    """Return the (2,) pixel position that most keypoints share at some time, or None.

    Args:
        xy: (..., K, 2) keypoints in pixels.
        confidence: (..., K) confidences, 0 where undetected.
    """
    count = confidence.shape[-1]
    points, seen = xy.reshape(-1, count, 2), confidence.reshape(-1, count) > 0
    seen &= np.isfinite(points).all(-1)
    rows = np.flatnonzero(seen.any(1))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, SAMPLED_PEOPLE).astype(int))] if len(rows) else rows
    few, chosen = points[rows], seen[rows]
    if not chosen.any():
        return None
    places, times = np.unique(few[chosen], axis=0, return_counts=True)
    place = places[times.argmax()]
    kinds = ((few == place).all(-1) & chosen).any(0).mean()
    if times.max() < _LEAST_SHARE * chosen.sum() or kinds < _MOST_KEYPOINTS:
        return None
    return place


_WITHIN = 0.99  # Quantile of the coordinates that decides, because a few detections are outside the image.
_LARGEST = 2.0  # Largest fraction of an image size. No person is two pixels large.
_CENTRED = 0.1  # Fraction of negative coordinates that shows an origin at the image centre.


def in_pixels(detections: Detections, image_size: np.ndarray) -> Detections:
    """Convert fractions of the image size, measured from a corner or the centre, to pixels.

    Args:
        image_size: (C, 2) width and height in pixels.
    """
    seen = detections.xy[(detections.confidence > 0) & np.isfinite(detections.xy).all(-1)]
    if not len(seen) or np.quantile(np.abs(seen), _WITHIN) > _LARGEST:
        return detections
    size = np.asarray(image_size, detections.xy.dtype)[:, None, None, None]  # (C, 1, 1, 1, 2)
    span = "unit"
    hands, xy = detections.hands, detections.xy
    if (seen < 0).mean() > _CENTRED:
        span = "centred"
        xy = (xy + 1) / 2
        hands = None if hands is None else np.concatenate([(hands[..., :2] + 1) / 2, hands[..., 2:]], -1)
    if hands is not None:
        hands = hands * np.concatenate([size, np.ones_like(size[..., :1])], axis=-1)[..., None, None, :]
    return replace(
        detections, xy=xy * size, hands=hands, notes=(*detections.notes, diagnostic("detections_scaled", span=span))
    )
