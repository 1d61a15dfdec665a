"""Markers that the body left far behind draw it once more: where the kernel had taken exact points for outliers.

A hand bent to its end is shown by one marker, 12 cm from where the prior expects it: at the last robust scale that is
an outlier that nothing draws at, and the objective itself is content, as giving up one marker costs less than a wrist
so far off the manifold. Optical markers whose labels passed their checks are not outliers for a tenth of a second.
"""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.keyframes.optimise import BundleModel, Schedule
from solver_backend.fitters.keyframes.restart import cut_out, keys_of, ranges_around
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.lost_limbs import WORN_M, lost_landmarks
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes, hemisphere_aligned
from solver_backend.fitters.model.subject import points_of
from solver_backend.geometry.arrays import to_numpy


def resolve_outlier_markers(
    measurements: Measurements, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, schedule: Schedule,
    frames: np.ndarray,
) -> Keyframes:  # fmt: skip
    """Return keys whose windows with far markers were solved again from wide scales on, where fewer stay far.

    Args:
        measurements: the markers of a calibrated person: a motion's own keypoints, which a clean-up solves, are none.
        model: what evaluates the keys; they may leave the manifold.
        layout: windows of the keys.
        keys: of a solution.
        schedule: of the last pass, from a scale at which far markers draw.
        frames: numbers of those that are looked at.

    Reference: Blake and Zisserman 1987, graduated non-convexity; Black and Rangarajan 1996.
    """
    far = _outliers(measurements, model, layout, keys, frames)
    windows_of, _ = layout.positions(frames)
    lost = np.zeros(layout.num_windows, dtype=bool)
    lost[windows_of[far.any(axis=1)]] = True
    for windows in ranges_around(lost):
        again = keys.replaced(keys_of(windows), cut_out(model, layout, keys, schedule, windows).solve().keys)
        here = (windows_of >= windows.start) & (windows_of < windows.stop)
        if _outliers(measurements, model, layout, again, frames[here]).sum() < far[here].sum():
            keys = again
    return hemisphere_aligned(keys)


def _outliers(
    measurements: Measurements, model: BundleModel, layout: KeyframeLayout, keys: Keyframes, frames: np.ndarray
) -> np.ndarray:
    """Return (F, M) bool: the marker is far from the body."""
    points = to_numpy(points_of(model.subject, model.poses(keys, layout, frames)))
    return lost_landmarks(points, measurements.points[frames], measurements.covariance[frames], WORN_M)
