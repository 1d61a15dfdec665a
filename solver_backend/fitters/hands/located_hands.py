"""Hands as the views alone have them: points in space, and how far off a take's detector has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.triangulation.triangulate import Triangulation, triangulate
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.fitters.measurements.hand_views import HandViews
from solver_backend.types.shapes import Bool, Float

NOISE_FRAMES = 20
"""Frames on which the detector's noise is measured, and twice as many at most."""
EVERY = 2
"""Frames from one located frame to the next: the start of a solve needs no more."""
LEAST_POINTS = 8
"""Points of a hand that a view must share with others for its offset to be one."""
ALIKE_FRAMES = 20.0
"""How many frames' worth of evidence there is that views have whole hands off alike."""
LEAST_WHOLE = 0.2
"""Least offsets of whole hands, as a share of the points' own noise: few frames show none."""
RANGE = (0.25, 4.0)
"""Least and largest variance of a point, as a share of the hand's median."""
_MEDIAN = 2.0 * float(np.log(2.0))
"""Median of a squared length in two dimensions, in variances per axis."""


@dataclass(frozen=True)
class HandNoise:
    """Standard deviations per axis of a detector of hands in a take, pixels."""

    own_px: Float[np.ndarray, " points"]
    """(21,) of each point about its hand."""
    whole_px: Float[np.ndarray, " views"]
    """(C,) of the whole hand in each view, with what is constant there, such as a camera's own error."""


@dataclass(frozen=True)
class LocatedHand:
    """One hand as the views alone have it."""

    points: Float[np.ndarray, "frames 21 3"]
    """(F, 21, 3) metres, NaN where no two views agree or nobody looked."""
    spread_m2: Float[np.ndarray, "frames 21"]
    """(F, 21) trace of the covariance by which points scatter about their hand."""
    noise: HandNoise
    """Of the detector."""


def locate_hands(views: HandViews) -> dict[int, LocatedHand]:
    """Return the hands that any view shows, by side, located in every other frame, which is enough to begin with."""
    both = views.xy.shape[2] * NUM_HAND_POINTS
    xy = views.xy.reshape(*views.xy.shape[:2], both, 2).astype(np.float64)
    confidence = views.confidence.reshape(*views.confidence.shape[:2], both).astype(np.float64)
    shown = np.flatnonzero(((views.confidence > 0).any(axis=-1).sum(axis=0) >= 2).any(axis=-1))
    sample = shown[:: max(1, len(shown) // NOISE_FRAMES)]
    rough = triangulate(views.cameras, xy[:, sample], confidence[:, sample])
    sigma_px = np.asarray(rough.sigma_px)
    used = shown[::EVERY]
    found = triangulate(views.cameras, xy[:, used], confidence[:, used], sigma_px)
    traces = np.trace(np.asarray(found.covariance), axis1=-2, axis2=-1)
    hands: dict[int, LocatedHand] = {}
    for side in np.flatnonzero((views.confidence > 0).any(axis=(0, 1, 3))):
        own = np.arange(side * NUM_HAND_POINTS, (side + 1) * NUM_HAND_POINTS)
        noise = hand_noise(views, xy[:, sample][:, :, own], rough.of_keypoints(own))
        points = np.full((xy.shape[1], NUM_HAND_POINTS, 3), np.nan)
        spread_m2 = np.full(points.shape[:2], np.nan)
        points[used], spread_m2[used] = found.points[:, own], traces[:, own] * (noise.own_px / sigma_px[own]) ** 2
        hands[int(side)] = LocatedHand(points, spread_m2, noise)
    return hands


def hand_noise(views: HandViews, xy: np.ndarray, found: Triangulation) -> HandNoise:
    """Return the noise of one hand's detections.

    Residuals of triangulated points split into their mean over a view's hand and what is left. A point of V views takes
    3 of their 2 V errors over, so that both variances are ``2 V / (2 V - 3)`` times as large as they look. Medians of
    squares leave outliers out.

    Args:
        views: whose cameras they are.
        xy: (C, n, 21, 2) px detected.
        found: triangulated from these.
    """
    cameras, used = views.cameras, np.asarray(found.inliers)
    points = np.asarray(found.points)
    px = project(cameras, points)
    error = (
        np.where(used[..., None], xy - px, 0.0)
        / np.sqrt(1.0 - 3.0 / (2.0 * np.maximum(used.sum(axis=0), 2.0)))[None, ..., None]
    )
    count = used.sum(-1)
    enough = count >= LEAST_POINTS
    if enough.sum() < LEAST_POINTS:
        sigma_px = np.asarray(found.sigma_px)
        return HandNoise(sigma_px, np.full(len(xy), LEAST_WHOLE * float(np.median(sigma_px))))
    mean = error.sum(2) / np.maximum(count, 1)[..., None]
    square = ((error - mean[:, :, None]) ** 2).sum(-1) * (count / np.maximum(count - 1.0, 1.0))[..., None]
    usable = used & enough[..., None]
    own = np.array([_variance(square[..., k], usable[..., k], np.nan) for k in range(square.shape[-1])])
    usual = float(np.nanmedian(own))
    own = np.clip(np.nan_to_num(own, nan=usual), RANGE[0] * usual, RANGE[1] * usual)
    offset, shown = (mean**2).sum(-1), enough.sum(axis=1)
    alike = _variance(offset, enough, usual)
    each = np.array([_variance(offset[view], enough[view], alike) for view in range(len(xy))])
    variance = (shown * each + ALIKE_FRAMES * alike) / (shown + ALIKE_FRAMES) - usual / NUM_HAND_POINTS
    return HandNoise(np.sqrt(own), np.sqrt(np.maximum(variance, LEAST_WHOLE**2 * usual)))


def _variance(square: np.ndarray, used: Bool[np.ndarray, "*any"], otherwise: float) -> float:
    """Return the variance per axis of squared lengths in two dimensions, by their median."""
    known = square[used]
    return float(np.median(known)) / _MEDIAN if len(known) >= LEAST_POINTS else otherwise
