"""Define the hands that views or marker clouds show, before they are assigned to wrists and measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from solver_backend.body.hand_markers import hand_columns, hand_place
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.types import Cameras, Keypoints2D, MarkerCloud


@dataclass(frozen=True)
class HandViews:
    """Detected points of both hands in C views and F frames."""

    cameras: Cameras  # C calibrated cameras.
    xy: np.ndarray  # (C, F, 2, 21, 2) px, left hand first, NaN where unseen.
    confidence: np.ndarray  # (C, F, 2, 21) in 0..1, 0 where unseen.

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D) -> HandViews | None:
        """Return a person's hand detections, or None if no view shows both a hand and the body."""
        if keypoints.hands is None:
            return None
        with_body = (keypoints.confidence > 0).any(axis=-1)[..., None, None]
        confidence = np.where(with_body, keypoints.hands[..., 2], 0.0)
        return cls(cameras, keypoints.hands[..., :2], confidence) if confidence.any() else None


NEAR_M, OFTEN = 0.06, 0.8
"""An unknown marker within this distance (m) of a hand marker in this share of common frames belongs to the hand."""


@dataclass(frozen=True)
class HandClouds:
    """Markers on one or both hands in F frames."""

    labels: Mapping[int, tuple[str, ...]]  # Locations from ``hand_markers`` by side, 0 left and 1 right.
    positions: Mapping[int, np.ndarray]  # (F, L, 3) metres by side, NaN where missing.
    extra_labels: Mapping[int, tuple[str, ...]] = field(default_factory=dict)  # Nearby unknown markers, by side.
    extra: Mapping[int, np.ndarray] = field(default_factory=dict)  # (F, N, 3) metres: their positions, by side.


def split_hands(
    cloud: MarkerCloud, own: Mapping[str, str] = MappingProxyType({})
) -> tuple[MarkerCloud, HandClouds | None]:
    """Split a cloud into body markers and hand markers, such as ``L_FT2``.

    An unknown marker that is always close to a hand marker belongs to the hand. A cloud without hand markers is
    returned unchanged, with None. ``own`` maps labels to user-assigned marker positions (see ``read_label_places``).
    """
    labels = cloud.names
    found = hand_columns([own.get(label, label) for label in labels])
    if not found:
        return cloud, None
    near = _near(cloud, found, own)
    taken = {column for columns in found.values() for column in columns.values()} | set(near)
    kept = [i for i in range(len(labels)) if i not in taken]
    beside = {side: [column for column, whose in near.items() if whose == side] for side in found}
    points = np.asarray(cloud.positions)
    return cloud.columns(kept), HandClouds(
        {side: tuple(columns) for side, columns in found.items()},
        {side: points[:, list(columns.values())] for side, columns in found.items()},
        {side: tuple(labels[c] for c in columns) for side, columns in beside.items() if columns},
        {side: points[:, columns] for side, columns in beside.items() if columns},
    )


def _near(cloud: MarkerCloud, found: Mapping[int, Mapping[str, int]], own: Mapping[str, str]) -> dict[int, int]:
    labels = cloud.names
    places = {label: place for label, place in own.items() if hand_place(place) is None}
    unknown = set(name_markers([label for label in labels if not is_unnamed(label)], places).unknown)
    points, near = np.asarray(cloud.positions), dict[int, int]()
    hands = {column for columns in found.values() for column in columns.values()}
    for column, label in enumerate(labels):
        if column in hands or label not in unknown or label in own:
            continue
        for side, columns in found.items():
            away = np.linalg.norm(points[:, list(columns.values())] - points[:, column, None], axis=-1)
            known = np.isfinite(away).any(axis=1)
            least = np.nanmin(np.where(known[:, None], away, np.inf), axis=1)[known]
            if len(least) and (least < NEAR_M).mean() >= OFTEN:
                near[column] = side
    return near
