"""Convert confidences to the range 0 to 1, and detected positions to pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.evidence import FRAMES, SAMPLED_FRAMES
from solver_backend.agreement.reading import sample
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.types import Detections

_MOST = 0.95
"""Fraction of numbers that determines the scale of all numbers. The rest are outliers. This quantile of confidences is
between 0.5 and 1.5 on a scale of 0 to 1, and 100 times as high in percent. On other scales it counts as certain."""


def on_unit_scale(confidence: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Convert confidences to 0..1, with 0 for undetected keypoints. Return notes and problems too."""
    confidence = np.where(np.isnan(confidence), 0.0, confidence).astype(confidence.dtype)
    seen, largest = confidence[confidence > 0], float(confidence.max(initial=0.0))
    if not len(seen):
        return confidence, (), ()
    few = len(seen) < FRAMES
    sure = float(np.quantile(seen, 0.5 if few else _MOST))
    if largest <= 1 and (few or 2 * sure >= 1):
        return confidence, (), ()
    if largest == 2 and np.isin(seen, (1, 2)).all():  # COCO's flags
        how, certain = "flags", 2.0
    elif 100 <= 2 * sure <= 300:  # a few scores may be larger
        how, certain = "percent", 100.0
    elif largest > 1 and 2 * sure <= 3:
        how, certain = "above", 1.0
    else:
        how, certain = "few" if few else "relative", sure
    scaled = np.minimum(confidence / certain, 1.0)
    if how in ("above", "flags"):
        return scaled, (diagnostic("confidence_rescaled", how=how, severity=Severity.NOTE, largest=largest),), ()
    return scaled, (), (diagnostic("confidence_rescaled", how=how, largest=largest),)


def from_logarithms(confidence: np.ndarray, written: np.ndarray) -> np.ndarray:
    """Convert logarithms of confidences to confidences, if nearly all points have different negative values.

    A negative value that many points have in common marks undetected points instead.
    """
    below, known = confidence[(confidence < 0) & written], written & np.isfinite(confidence)
    is_logarithm = len(below) >= max(FRAMES, _MOST * known.sum())
    is_logarithm = is_logarithm and bool((below != below[0]).any()) and not (confidence[known] > 0).any()
    return np.where(known, np.exp(np.minimum(confidence, 0.0)), 0.0) if is_logarithm else confidence


def placeholder(xy: np.ndarray, confidence: np.ndarray) -> np.ndarray | None:
    """Find the (2,) position that a program wrote for undetected keypoints (..., K, 2), or return None."""
    count = confidence.shape[-1]
    points, seen = xy.reshape(-1, count, 2), confidence.reshape(-1, count) > 0
    seen &= np.isfinite(points).all(-1)
    rows = np.flatnonzero(seen.any(1))
    rows = rows[sample(len(rows), SAMPLED_FRAMES)]
    few, chosen = points[rows], seen[rows]
    if not chosen.any():
        return None
    places, times = np.unique(few[chosen], axis=0, return_counts=True)
    place = places[times.argmax()]
    kinds = ((few == place).all(-1) & chosen).any(0).mean()
    usual = times.max() < (1 - _MOST) * chosen.sum() or 2 * kinds < 1  # a body has only one keypoint at a position
    return None if usual else place


_LARGEST = 2.0  # Largest fraction of an image size. No person is two pixels large.


def in_pixels(detections: Detections, image_size: np.ndarray) -> Detections:
    """Convert detections that are fractions of the image sizes (C, 2) to pixels. Others are pixels already.

    Fractions are measured from the corner, or from the centre with -1 and 1 at the edges.
    """
    seen = detections.xy[(detections.confidence > 0) & np.isfinite(detections.xy).all(-1)]
    if not len(seen) or np.quantile(np.abs(seen), _MOST) > _LARGEST:
        return detections
    size = np.asarray(image_size, detections.xy.dtype)[:, None, None, None]  # (C, 1, 1, 1, 2)
    span = "centred" if np.quantile(seen, 1 - _MOST) < 0 else "unit"
    corner, scale = (-1, size / 2) if span == "centred" else (0, size)
    xy, hands = (detections.xy - corner) * scale, detections.hands
    if hands is not None:
        hands = np.concatenate([(hands[..., :2] - corner) * scale[..., None, :], hands[..., 2:]], axis=-1)
    notes = (*detections.notes, diagnostic("detections_scaled", span=span))
    return replace(detections, xy=xy, hands=hands, notes=notes)
