"""Detections as shares of the picture (MediaPipe, Ultralytics) instead of pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.exchange.diagnostics import diagnostic

_LARGEST = 2.0
"""Shares lie in 0..1, a little beyond for what is out of the picture; a person two pixels large is none."""
_QUANTILE = 0.99
"""Share of the coordinates that lie within 0 to 1: a few detections lie outside pictures."""
_CENTRED = 0.1
"""Share of coordinates below 0 from which shares count from the picture's centre: beyond its edges lie few."""


def in_pixels(detections: Detections, image_size: np.ndarray) -> Detections:
    """Return detections in pixels: shares of width and height, from a corner or the centre, become pixels.

    Args:
        detections: everybody in every view.
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
