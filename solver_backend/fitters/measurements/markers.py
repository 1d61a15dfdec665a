"""Optical markers that are named: places on the skin, measured without cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.markers import known_markers, marker_landmarks
from solver_backend.exchange.errors import MarkersUnknown, NoDetections
from solver_backend.fitters.measurements.base import Measurements, seen_frames
from solver_backend.geometry.arrays import Array, constant
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types import MarkerCloud

SIGMA_M = 0.01
"""Standard deviation of a marker against the body, per axis: skin that slides, and placement while it is learned."""


def measure_markers(cloud: MarkerCloud, body: Body, like: Array, sigma_m: float = SIGMA_M) -> Measurements:
    """Return what labelled markers measure.

    Args:
        cloud: every marker labelled, by a name of ``body.markers`` with or without a subject's name and a colon.
        body: on whose skin they sit.
        like: array that says kind, type and device.
        sigma_m: standard deviation of a marker against the body, per axis.

    Raises:
        MarkersUnknown: there are no labels, one stands twice or is of no known layout.
        NoDetections: in no frame enough markers are there to place a body.
    """
    labels = _labels(cloud)
    points = np.asarray(cloud.positions, dtype=np.float64)
    located = np.isfinite(points).all(-1)
    points = np.where(located[..., None], points, np.nan)
    if not seen_frames(points).any():
        raise NoDetections("In no frame are there enough markers to place a body.", hint="Choose another recording.")
    filled = np.where(located[..., None], points, 0.0)
    return Measurements(
        landmarks=marker_landmarks(body, labels),
        points=points,
        covariance=np.zeros((*points.shape, 3)),
        term=PositionTerm(constant(filled, like), constant(located * sigma_m**-2, like)),
        fps=cloud.fps,
        report=MarkerReport(points),
        provenance={"markers": list(labels), "sigma_mm": round(1000 * sigma_m, 3)},
    )


@dataclass(frozen=True)
class MarkerReport:
    """How far points are from the markers, in millimetres."""

    markers: np.ndarray
    """(F, L, 3) metres, NaN where missing."""

    def __call__(self, points: np.ndarray) -> tuple[None, dict[str, float]]:
        """Return None, as there are no images, and statistics of (F, L, 3) points."""
        error = 1000 * np.linalg.norm(points - self.markers, axis=-1)
        median, rmse = np.nanmedian(error), np.sqrt(np.nanmean(error**2))
        return None, {"marker_median_mm": float(median), "marker_rmse_mm": float(rmse)}


def _labels(cloud: MarkerCloud) -> tuple[str, ...]:
    """Return the markers' names without the subject's."""
    if cloud.labels is None:
        raise MarkersUnknown("The markers have no labels.", hint="Label them in the program that recorded them.")
    labels = tuple(label.split(":")[-1] for label in cloud.labels)
    known = known_markers()
    unknown = sorted({label for label in labels if label not in known})
    if unknown:
        raise MarkersUnknown(
            f"No layout knows the marker{'s' if len(unknown) > 1 else ''} {', '.join(unknown)}.",
            hint=f"Known markers: {', '.join(sorted(known))}.",
        )
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise MarkersUnknown(
            f"The label {', '.join(twice)} stands twice.", hint="Every marker needs a name of its own."
        )
    return labels
