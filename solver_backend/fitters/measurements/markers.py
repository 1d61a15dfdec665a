"""Optical markers that are named: places on the skin, measured without cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import LEAST_LIMB_MARKERS, LEAST_MARKERS, least_markers, name_markers
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import MarkersUnknown, NoDetections
from solver_backend.fitters.measurements.base import Measurements, seen_frames
from solver_backend.geometry.arrays import Array, constant
from solver_backend.residuals.positions import PositionTerm
from solver_backend.types import MarkerCloud

SIGMA_M = 0.01
"""Standard deviation of a marker against the body, per axis: skin that slides, and placement while it is learned."""


def known_markers_of(cloud: MarkerCloud, own: Mapping[str, str] = MappingProxyType({})) -> MarkerCloud:
    """Return the markers whose labels a layout knows, or whose place the user gave (see ``name_markers``).

    Raises:
        MarkersUnknown: there are no labels, or fewer of them are known than ``least_markers``.
    """
    labels = _require_labels(cloud)
    names = name_markers(labels, own)
    if len(names.known) < least_markers(names.known.values()):
        read = [label for label in labels if label not in names.virtual]
        words = load_layouts().words
        sideless = [label for label in names.unknown if words.lacks_side(names.affixes.bare(label))]
        hint = "Label the markers by a layout such as Plug-in Gait, or add markers: fewer leave limbs open."
        if sideless:
            hint = (
                f"Labels name a limb without its side: {_listed(tuple(sideless))}. Write the limb's places (as LELB, "
                "RWRA) with `layout`, and solve with --layout."
            )
        raise MarkersUnknown(
            f"A body is solved from at least {LEAST_MARKERS} markers that a layout knows, an arm or a leg alone from "
            f"{LEAST_LIMB_MARKERS}; {len(names.known)} of the {len(labels)} labels are known: "
            f"{_listed(tuple(names.known))}. Read were {_listed(tuple(read))}.",
            where="markers",
            hint=hint,
        )
    kept = [i for i, label in enumerate(labels) if label in names.known]
    return cloud.columns(kept, tuple(labels[i] for i in kept))


def measure_markers(
    cloud: MarkerCloud, body: Body, like: Array, sigma_m: float = SIGMA_M, own: Mapping[str, str] = MappingProxyType({})
) -> Measurements:
    """Return what labelled markers measure.

    Args:
        cloud: every marker labelled by a name that a layout knows (see ``LayoutFile.place_of``).
        body: on whose skin they sit.
        like: array that sets kind, type and device.
        sigma_m: standard deviation of a marker against the body, per axis.
        own: places that the user gave, see ``name_markers``.

    Raises:
        MarkersUnknown: there are no labels, one stands twice or is of no known layout.
        NoDetections: in no frame enough markers are there to place a body.
    """
    return measured_at(
        cloud, marker_landmarks(body, _places(cloud, own)), like, np.full(len(cloud.labels or ()), sigma_m)
    )


def measured_at(cloud: MarkerCloud, landmarks: Landmarks, like: Array, sigma_m: np.ndarray) -> Measurements:
    """Return what markers measure whose landmarks are known.

    Args:
        cloud: F frames of L labelled markers. The tracker's own error adds to the place's: covariances
            Σ to ``σ_marker² 1 + Σ``, else residuals to ``σ_marker² + residual²``.
        landmarks: the L places of the markers on the body.
        like: array that sets kind, type and device.
        sigma_m: (L,) standard deviation of each marker against the body, per axis.

    Raises:
        NoDetections: in no frame enough markers are there to place a body.
    """
    points = np.asarray(cloud.positions, dtype=np.float64)
    located = np.isfinite(points).all(-1)
    points = np.where(located[..., None], points, np.nan)
    if not seen_frames(points).any():
        raise NoDetections("In no frame are there enough markers to place a body.", hint="Choose another recording.")
    noise = np.zeros((*points.shape, 3)) if cloud.covariance is None else np.nan_to_num(cloud.covariance)
    if cloud.covariance is None:
        own = 0.0 if cloud.residual is None else np.nan_to_num(np.maximum(cloud.residual, 0.0)) ** 2
        filled = np.where(located[..., None], points, 0.0)
        term = PositionTerm(constant(filled, like), constant(located / (sigma_m**2 + own), like))
    else:
        term = PositionTerm.of(points, noise + (sigma_m**2)[:, None, None] * np.eye(3), like)
    return Measurements(
        landmarks=landmarks,
        points=points,
        covariance=noise,
        term=term,
        fps=cloud.fps,
        report=MarkerResiduals(points),
        marker_labels=cloud.labels,
        provenance={
            "markers": list(landmarks.names),
            "sigma_mm": [round(1000 * float(value), 3) for value in sigma_m],
        },
    )


@dataclass(frozen=True)
class MarkerResiduals:
    """How far points are from the markers, in millimetres."""

    markers: np.ndarray
    """(F, L, 3) metres, NaN where missing."""

    def __call__(self, points: np.ndarray) -> tuple[None, dict[str, float]]:
        """Return None, as there are no images, and statistics of (F, L, 3) points, over all seen markers together."""
        error = 1000 * np.linalg.norm(points - self.markers, axis=-1)
        error = error[np.isfinite(error)]
        return None, {
            "marker_mean_mm": float(error.mean()),
            "marker_median_mm": float(np.median(error)),
            "marker_p95_mm": float(np.quantile(error, 0.95)),
            "marker_rmse_mm": float(np.sqrt((error**2).mean())),
        }


def _require_labels(cloud: MarkerCloud) -> tuple[str, ...]:
    if cloud.labels is None:
        raise MarkersUnknown("The markers have no labels.", hint="Label them in the program that recorded them.")
    return cloud.labels


def _places(cloud: MarkerCloud, own: Mapping[str, str]) -> tuple[str, ...]:
    """Return the place of every marker."""
    labels, layouts = _require_labels(cloud), load_layouts()
    names = name_markers(labels, own)
    if unknown := sorted({label.rpartition(":")[2] for label in (*names.unknown, *names.virtual)}):
        raise MarkersUnknown(
            f"No layout knows the marker{'s' if len(unknown) > 1 else ''} {', '.join(unknown)}.",
            hint=f"Known markers: {', '.join(sorted(set(layouts.names.values())))}.",
        )
    if len(names.known) < len(labels):
        taken = [names.known.get(label) or layouts.place_of(label) for label in labels]
        twice = sorted({str(place) for place in taken if taken.count(place) > 1})
        raise MarkersUnknown(
            f"The label {', '.join(twice)} stands twice.", hint="Every marker needs a name of its own."
        )
    return tuple(names.known[label] for label in labels)


def _listed(labels: tuple[str, ...], most: int = 12) -> str:
    more = f" and {len(labels) - most} others" if len(labels) > most else ""
    return (", ".join(labels[:most]) or "none") + more
