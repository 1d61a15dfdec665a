"""Whose hand a detection is: the left one lies at the left wrist, and what lies at neither is another's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.fitters.measurements.hand_views import HandViews
from solver_backend.geometry.runs import true_runs

NEAR = 0.8
"""A hand's wrist lies this near the body's at most, in lengths of the forearm in the picture: the detector's errors and
the body's together are a third of that."""
CLEARLY = 0.5
"""Hands are exchanged where they lie nearer to each other's wrists by this many forearms."""
LEAST_FRAMES = 3
"""Shorter stretches are corrected without a word."""


@dataclass(frozen=True)
class SortedHands:
    """Hands by side, and what was found of them."""

    views: HandViews
    """The detections of each side at that side's wrist."""
    diagnostics: tuple[Diagnostic, ...]
    """What was exchanged, and what was left out."""


def sort_hands(views: HandViews, wrists: np.ndarray, elbows: np.ndarray) -> SortedHands:
    """Return detections by the wrists they lie at; hands that lie at no wrist are left out.

    A frame's two hands in one view are exchanged where both lie nearer to each other's wrist; one alone where it does.

    Args:
        views: as detected.
        wrists: (F, 2, 3) metres, of the solved body, left first.
        elbows: (F, 2, 3).
    """
    at, up = (_in_pictures(views, points) for points in (wrists, elbows))
    forearm = np.maximum(np.linalg.norm(at - up, axis=-1).max(axis=-1), 1.0)[..., None, None]
    seen = views.confidence[..., 0] > 0
    there = np.where(seen[..., None], views.xy[:, :, :, 0], np.nan)
    # (C, F, detected side, side of the body)
    distance = np.linalg.norm(there[:, :, :, None] - at[:, :, None], axis=-1) / forearm
    far = np.nan_to_num(distance, nan=0.0)
    gain = (far[..., 0, 0] + far[..., 1, 1]) - (far[..., 0, 1] + far[..., 1, 0])
    exchanged = gain > CLEARLY
    order = np.where(exchanged[..., None], [1, 0], [0, 1])
    xy = np.take_along_axis(views.xy, order[..., None, None], axis=2)
    confidence = np.take_along_axis(views.confidence, order[..., None], axis=2)
    own = np.take_along_axis(distance, order[..., None], axis=2)[..., [0, 1], [0, 1]]
    elsewhere = np.nan_to_num(own, nan=0.0) > NEAR
    confidence = np.where(elsewhere[..., None], 0.0, confidence)
    found = [*_named(views, "hands_exchanged", exchanged, Remedy.REPAIRED)]
    found += _named(views, "hand_elsewhere", elsewhere.any(axis=-1), Remedy.EXCLUDED)
    return SortedHands(HandViews(views.cameras, xy, confidence), tuple(found))


def _in_pictures(views: HandViews, points: np.ndarray) -> np.ndarray:
    """Return (C, F, 2, 2) px of (F, 2, 3) points."""
    cameras = views.cameras
    return project(cameras, points)


def _named(views: HandViews, code: str, found: np.ndarray, remedy: Remedy) -> list[Diagnostic]:
    """Return a diagnostic for each view with (C, F) findings that last."""
    named = []
    for view in np.flatnonzero(found.any(axis=1)):
        runs = [run for run in true_runs(found[view]) if run[1] - run[0] + 1 >= LEAST_FRAMES]
        if runs:
            named.append(diagnostic(code, cameras=[views.cameras.names[view]], frames=runs, remedy=remedy))
    return named
