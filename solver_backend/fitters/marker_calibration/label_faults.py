"""Labels that another marker took for a while, and points where no marker can be: found by the body, corrected."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.geometry.runs import true_runs
from solver_backend.residuals.robust import geman_mcclure
from solver_backend.types import MARKER_GHOST, MARKER_SWAPPED

WINDOW_S = 0.1
"""Hypotheses are compared over so long: one frame is noise."""
SIGMA_M = 0.02
"""How far a marker is from where the body and its neighbours have it, per axis, while poses are rough."""
SCALE = 4.0
"""Of Geman-McClure's penalty, in these."""
GAIN = 3.0
"""What a change of labels must gain by marker, in the mean of a window's frames, in halves of squared deviations."""
GHOST_M = 0.11
"""A point so far from where its marker must be is none."""
MOST_NAMED = 5
"""Markers of a take that have a note each; of more a program's habit is the cause, which is one note."""


@dataclass(frozen=True)
class LabelFault:
    """A label that was wrong in a range of frames."""

    marker: int
    """Whose label it is."""
    other: int
    """The marker that had it; the same where it was none."""
    first: int
    """First frame."""
    last: int
    """Last frame."""


@dataclass(frozen=True)
class CleanedLabels:
    """Markers with corrected labels."""

    points: np.ndarray
    """(F, M, 3) metres; NaN where missing or where a point was no marker."""
    flags: np.ndarray
    """(F, M) uint8 of ``MARKER_SWAPPED`` and ``MARKER_GHOST``."""
    faults: tuple[LabelFault, ...]
    """What was found, by first frame."""


def clean_labels(
    points: np.ndarray, expected: np.ndarray, around: np.ndarray, tested: np.ndarray, fps: float
) -> CleanedLabels:
    """Return the markers with exchanged labels corrected and ghosts left out.

    For two neighbours a and b, ``g(t) = ρ(x_a - y_a) + ρ(x_b - y_b) - ρ(x_a - y_b) - ρ(x_b - y_a)`` is what an
    exchange of labels gains; where its mean over a window is large, they are exchanged. A label whose own marker is
    missing may simply be the other's.

    Args:
        points: (F, M, 3) metres, NaN where missing.
        expected: (F, M, 3) where a body has the markers, roughly.
        around: (M, n) neighbours of each.
        tested: (M,) bool: labels that may be wrong.
        fps: frames per second.
    """
    points, flags, faults = points.copy(), np.zeros(points.shape[:2], np.uint8), []
    shifted = expected + shared_error(points - expected, around)
    pairs = {(min(a, b), max(a, b)) for a in np.flatnonzero(tested) for b in around[a]}
    gains = {pair: _gain(points, shifted, *pair) for pair in pairs}
    half = max(1, round(0.5 * WINDOW_S * fps))
    for a, b in sorted(pairs, key=lambda pair: -gains[pair].sum(where=gains[pair] > 0)):
        gain = _gain(points, shifted, a, b) / np.maximum(np.isfinite(points[:, [a, b], 0]).sum(-1), 1)
        for first, last in true_runs(_smoothed(gain, half) > GAIN):
            first, last = _trimmed(gain, first, last)
            if last < first:
                continue
            stretch = slice(first, last + 1)
            points[stretch, [a, b]] = points[stretch, [b, a]]
            flags[stretch, a] |= MARKER_SWAPPED
            flags[stretch, b] |= MARKER_SWAPPED
            faults.append(LabelFault(int(a), int(b), first, last))
    off = np.linalg.norm(points - shifted, axis=-1)
    ghosts = (np.nan_to_num(off) > GHOST_M) & tested
    for m in np.flatnonzero(ghosts.any(axis=0)):
        faults += [LabelFault(int(m), int(m), first, last) for first, last in true_runs(ghosts[:, m])]
    points[ghosts] = np.nan
    flags[ghosts] |= MARKER_GHOST
    return CleanedLabels(points, flags, tuple(sorted(faults, key=lambda fault: (fault.first, fault.marker))))


def shared_error(off: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return (F, M, 3): how far the body is off around each marker, the median of its neighbours' (0 if unknown)."""
    ordered = np.sort(off[:, around], axis=2)  # (F, M, n, 3); what is missing comes last
    count = np.maximum(np.isfinite(ordered).sum(axis=2, keepdims=True), 1)
    middle = [np.take_along_axis(ordered, place, 2) for place in ((count - 1) // 2, count // 2)]
    return np.nan_to_num(0.5 * (middle[0] + middle[1])[:, :, 0])


def _gain(points: np.ndarray, expected: np.ndarray, a: int, b: int) -> np.ndarray:
    """Return (F,) what an exchange of two labels gains."""
    straight = _misfit(points[:, a] - expected[:, a]) + _misfit(points[:, b] - expected[:, b])
    return straight - _misfit(points[:, a] - expected[:, b]) - _misfit(points[:, b] - expected[:, a])


def _misfit(off: np.ndarray) -> np.ndarray:
    """Return (F,) half the robust square of (F, 3) errors; 0 where one is missing."""
    squared = (off * off).sum(-1) / SIGMA_M**2
    return 0.5 * geman_mcclure(np.nan_to_num(squared), SCALE)[0]


def _smoothed(gain: np.ndarray, half: int) -> np.ndarray:
    """Return the mean over the frames within a window."""
    total = np.concatenate([[0.0], np.cumsum(gain)])
    index = np.arange(len(gain))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(gain))
    return (total[high] - total[low]) / (high - low)


def _trimmed(gain: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """Return the part of a stretch, widened by what gains beside it, at whose ends an exchange gains."""
    while first > 0 and gain[first - 1] > 0:
        first -= 1
    while last < len(gain) - 1 and gain[last + 1] > 0:
        last += 1
    while first <= last and gain[first] <= 0:
        first += 1
    while last >= first and gain[last] <= 0:
        last -= 1
    return first, last


def diagnose_labels(still: np.ndarray, faults: tuple[LabelFault, ...], labels: tuple[str, ...]) -> list[Diagnostic]:
    """Return what was found as the motion records it, by first frame.

    Args:
        still: (F, M) bool: markers that stand still and are none.
        faults: of the labels.
        labels: of the M markers.
    """
    found = [
        diagnostic("marker_still", markers=[labels[m]], frames=[run], remedy=Remedy.BRIDGED)
        for m in np.flatnonzero(still.any(axis=0))
        for run in true_runs(still[:, m])
    ]
    for fault in faults:
        frames = [(fault.first, fault.last)]
        if fault.marker == fault.other:
            ghost = [labels[fault.marker]]
            found.append(diagnostic("marker_ghost", markers=ghost, frames=frames, remedy=Remedy.BRIDGED))
        else:
            pair = sorted((labels[fault.marker], labels[fault.other]))
            found.append(diagnostic("markers_exchanged", markers=pair, frames=frames, remedy=Remedy.REPAIRED))
    return sorted(found, key=lambda item: (item.where.frames, item.where.markers))


def gathered(found: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Return the diagnostics, those of one code about more than ``MOST_NAMED`` markers as one with their count."""
    items = list(found)
    for code in ("marker_ghost", "marker_still"):
        alike = [item for item in items if item.code == code]
        labels = list(dict.fromkeys(label for item in alike for label in item.where.markers))
        if len(labels) <= MOST_NAMED:
            continue
        frames = {frame for item in alike for a, b in item.where.frames for frame in range(a, b + 1)}
        there = np.isin(np.arange(max(frames) + 1), list(frames))
        several = diagnostic(
            f"{code}s", markers=labels, frames=true_runs(there), remedy=alike[0].remedy, count=len(labels)
        )
        items = [several if item is alike[0] else item for item in items if item is alike[0] or item.code != code]
    return items
