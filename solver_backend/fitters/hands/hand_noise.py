"""How far the points of a hand may miss its detections: the detector's noise, small hands, other people's bones."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import CameraArrays
from solver_backend.fitters.hands.hand_view_term import HandViewTerm
from solver_backend.fitters.hands.located_hands import HandNoise
from solver_backend.fitters.measurements.hand_views import HandViews
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types.shapes import Float

SMALL_PX = 15.0
"""A palm of fewer pixels is no hand to a detector: its points are guesses about as large as it is."""
PALM_M = 0.09
"""From the wrist to the middle finger's knuckle."""
MODEL_ERROR_M = 0.004
"""Standard deviation per axis by which fingers of another build miss a detector's points; a sixth of a bone."""

ALONE = 0.04
"""What a hand counts that one view alone shows: nothing separates a palm from its mirror image in depth there, and a
wrist that follows the wrong one turns by half a circle."""


def hand_term(views: HandViews, side: int, wrists: Float[np.ndarray, "frames 3"], noise: HandNoise) -> HandViewTerm:
    """Return the data term of one hand.

    ``σ² = (σ_l max(1, (15 / s)²))² + (f m / z)²`` px² with a palm of s = f 0.09 m / z px at the depth z of the wrist.

    Args:
        views: detected points.
        side: 0 left, 1 right.
        wrists: (F, 3) metres.
        noise: of the detector.
    """
    px_per_m = pixels_per_metre(views, wrists)[..., None]
    small = np.maximum(1.0, (SMALL_PX / (PALM_M * px_per_m)) ** 2)
    sigma = np.hypot(noise.own_px * small, MODEL_ERROR_M * px_per_m)
    xy, confidence = views.xy[:, :, side], views.confidence[:, :, side]
    seen = np.isfinite(xy).all(-1) & (confidence > 0)
    alone = seen.any(axis=-1).sum(axis=0) < 2
    confidence = np.where(alone[:, None], ALONE * confidence, confidence)
    points = ReprojectionTerm(
        CameraArrays.of(views.cameras, sigma),
        np.where(seen[..., None], xy, 0.0), np.where(seen, confidence, 0.0) / sigma**2, np.where(seen, confidence, 0.0),
    )  # fmt: skip
    return HandViewTerm(points, noise.whole_px)


def pixels_per_metre(views: HandViews, wrists: np.ndarray) -> Float[np.ndarray, "views frames"]:
    """Return (C, F) how large a metre is in each picture at (F, 3) places."""
    cameras = views.cameras
    depth = np.einsum("cj,fj->cf", cameras.R[:, 2], wrists) + cameras.t[:, 2, None]
    return np.sqrt(cameras.K[:, 0, 0] * cameras.K[:, 1, 1])[:, None] / np.maximum(depth, 0.1)
