"""Landmarks that something located in space already: markers, joints, or both (thesis 5.2.2)."""

from __future__ import annotations

import numpy as np

from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.fitters.measurements.base import Measurements, seen_frames
from solver_backend.fitters.measurements.markers import SIGMA_M, MarkerResiduals
from solver_backend.geometry.arrays import Array, constant
from solver_backend.residuals.positions import PositionTerm


def measure_landmarks(
    landmarks: Landmarks, points: np.ndarray, fps: float, like: Array, sigma_m: float = SIGMA_M
) -> Measurements:
    """Return what landmarks at known places of the body measure.

    Args:
        landmarks: the L points on the body.
        points: (F, L, 3) world metres, NaN where a landmark was not located.
        fps: frames per second.
        like: array that sets kind, type and device.
        sigma_m: standard deviation of a landmark, per axis.

    Raises:
        NoDetections: in no frame enough landmarks are there to place a body.
    """
    points = np.asarray(points, dtype=np.float64)
    located = np.isfinite(points).all(-1)
    points = np.where(located[..., None], points, np.nan)
    if not seen_frames(points).any():
        raise NoDetections("In no frame are there enough landmarks to place a body.", hint="Choose another recording.")
    term = PositionTerm(
        constant(np.where(located[..., None], points, 0.0), like), constant(located * sigma_m**-2, like)
    )
    return Measurements(
        landmarks=landmarks,
        points=points,
        covariance=np.zeros((*points.shape, 3)),
        term=term,
        fps=fps,
        report=MarkerResiduals(points),
        marker_labels=landmarks.names,
        provenance={"landmarks": list(landmarks.names), "sigma_mm": round(1000 * sigma_m, 3)},
    )
