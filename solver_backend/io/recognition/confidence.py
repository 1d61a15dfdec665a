"""Bring confidences to 0..1 and detections to pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.reading import Detections
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic

PER_CENT = 100.0
_LOW, _SURE = 0.5, 0.95
"""Confidences are relative: if this quantile of the seen keypoints is below the first number, it counts as certain."""
_TYPICAL_PER_CENT = 10.0  # Per cent are typically above this. Other scores beyond 1 reach a few units.
_FEWEST = 100  # Points that show a scale.


def on_unit_scale(confidence: np.ndarray) -> tuple[np.ndarray, tuple[Diagnostic, ...], tuple[Diagnostic, ...]]:
    """Return confidences in 0..1, notes and problems: low ones and per cent are rescaled, others above 1 count as 1.

    Args:
        confidence: of one joint set and take, any shape, 0 where unseen.
    """
    largest = float(confidence.max(initial=0.0))
    seen = confidence[confidence > 0]
    if len(seen) >= _FEWEST and largest <= 1 and (sure := float(np.quantile(seen, _SURE))) < _LOW:
        return np.minimum(confidence / sure, 1.0), (), (diagnostic("confidence_rescaled", how="low", largest=largest),)
    if largest <= 1:
        return confidence, (), ()
    if largest <= PER_CENT and float(np.median(confidence[confidence > 0])) > _TYPICAL_PER_CENT:
        return confidence / PER_CENT, (), (diagnostic("confidence_rescaled", how="percent", largest=largest),)
    clipped = np.minimum(confidence, 1.0)
    if largest > PER_CENT:
        return clipped, (), (diagnostic("confidence_rescaled", how="beyond", largest=largest),)
    return clipped, (diagnostic("confidence_rescaled", how="above", severity=Severity.NOTE, largest=largest),), ()


_LEAST_SHARE = 0.01  # Least share of all points in one place.
_MOST_KEYPOINTS = 0.5
"""Least share of the kinds of keypoints that are there at some time. A body has no two keypoints in one place."""
_SAMPLE = 20_000  # Points that are searched.


def placeholder(xy: np.ndarray, confidence: np.ndarray) -> np.ndarray | None:
    """Return the (2,) place in pixels where most kinds of keypoints are at some time, None if there is none.

    Args:
        xy: (..., K, 2) px.
        confidence: (..., K), 0 where unseen.
    """
    count = confidence.shape[-1]
    points, seen = xy.reshape(-1, count, 2), confidence.reshape(-1, count) > 0
    seen &= np.isfinite(points).all(-1)
    rows = np.flatnonzero(seen.any(1))
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, max(1, _SAMPLE // count)).astype(int))] if len(rows) else rows
    few, chosen = points[rows], seen[rows]
    if not chosen.any():
        return None
    places, times = np.unique(few[chosen], axis=0, return_counts=True)
    place = places[times.argmax()]
    kinds = ((few == place).all(-1) & chosen).any(0).mean()
    if times.max() < _LEAST_SHARE * chosen.sum() or kinds < _MOST_KEYPOINTS:
        return None
    return place


_LARGEST = 2.0  # Shares of the picture are within 0..1 or a little outside. No person is two pixels large.
_QUANTILE = 0.99  # Share of the coordinates that lie within 0 to 1: a few detections lie outside pictures.
_CENTRED = 0.1  # Share of coordinates below 0 that shows an origin in the picture's centre: few are beyond the edges.


def in_pixels(detections: Detections, image_size: np.ndarray) -> Detections:
    """Convert shares of width and height, from a corner or the centre, to pixels.

    Args:
        image_size: (C, 2) width and height in pixels.
    """
    seen = detections.xy[(detections.confidence > 0) & np.isfinite(detections.xy).all(-1)]
    if not len(seen) or np.quantile(np.abs(seen), _QUANTILE) > _LARGEST:
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
