"""Detections as shares of the picture (MediaPipe, Ultralytics) instead of pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.people.detections import Detections

_LARGEST = 2.0
"""Shares lie in 0..1, a little beyond for what is out of the picture; a person two pixels large is none."""
_QUANTILE = 0.99
"""Share of the coordinates that lie within 0 to 1: a few detections lie outside pictures."""


def in_pixels(detections: Detections, image_size: np.ndarray) -> Detections:
    """Return detections in pixels: shares of width and height are multiplied by the picture's size, and said.

    Args:
        detections: everybody in every view.
        image_size: (C, 2) width and height in pixels.
    """
    seen = np.abs(detections.xy[(detections.confidence > 0) & np.isfinite(detections.xy).all(-1)])
    if not len(seen) or np.quantile(seen, _QUANTILE) > _LARGEST:
        return detections
    size = np.asarray(image_size, detections.xy.dtype)[:, None, None, None]  # (C, 1, 1, 1, 2)
    note = "The detections are shares of the picture (0..1); they are multiplied by its width and height."
    hands = detections.hands
    if hands is not None:
        hands = hands * np.concatenate([size, np.ones_like(size[..., :1])], axis=-1)[..., None, None, :]
    return replace(detections, xy=detections.xy * size, hands=hands, notes=(*detections.notes, note))
