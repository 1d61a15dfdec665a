"""Find and correct wrong labels and ghost points in a take, by comparison with the fitted body."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.agreement.body_evidence import MEAN_STATURE_M
from solver_backend.agreement.evidence import BOUND, count_in_bins, fit_noise, log_density
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.body.markers import ON_BONE
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.fitters.marker_calibration.calibrate import varied_frames
from solver_backend.fitters.marker_calibration.label_evidence import exchanged_wrists
from solver_backend.fitters.marker_calibration.person_doubts import over_takes
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_to_points, posed
from solver_backend.geometry.arrays import Array, quantile, to_numpy, true_runs
from solver_backend.geometry.marker_jumps import neighbours_of
from solver_backend.labelling.label_like import NameChange, NamesOverTakes, names_over_takes, with_exchanged
from solver_backend.types import MARKER_GHOST, MARKER_SWAPPED, MarkerCloud

WINDOW_S = 0.1  # Window in seconds for averaging hypotheses, because single frames are noisy.
GHOST_M = 0.11  # Smallest distance between a ghost and the expected position.
MOST_NAMED = 5  # Largest number of markers with separate diagnostics. More share a cause and get one diagnostic.


@dataclass(frozen=True)
class LabelFault:
    """Wrong label in the frames from ``first`` to ``last``."""

    marker: int  # Column of the label.
    other: int  # Marker that it was swapped with, or the same one for a ghost.
    first: int
    last: int


@dataclass(frozen=True)
class CleanedLabels:
    """Markers of a take with corrected labels."""

    points: np.ndarray  # (F, M, 3) metres, NaN where missing or excluded as a ghost.
    flags: np.ndarray  # (F, M) uint8 flags ``MARKER_SWAPPED`` and ``MARKER_GHOST``.
    faults: tuple[LabelFault, ...]  # In order of the first frame.


def clean_labels(
    points: np.ndarray, expected: np.ndarray, around: np.ndarray, tested: np.ndarray, fps: float
) -> CleanedLabels:
    """Correct swapped labels, and exclude ghost points.

    For two neighbours a and b, the gain from a label swap is ``log p(x_a - y_b) + log p(x_b - y_a) - log p(x_a - y_a) -
    log p(x_b - y_b)`` in nats, where p is the take's own noise. The labels are swapped if the mean gain over a window
    is at least ``BOUND``. If only one of the two markers is visible, it gets the other label.

    Args:
        points: (F, M, 3) measured markers x in metres, NaN where missing.
        expected: (F, M, 3) the same markers y on the body.
        around: (M, n) neighbours of each marker.
        tested: (M,) bool, true for labels that may be wrong.
    """
    points, flags, faults = points.copy(), np.zeros(points.shape[:2], np.uint8), []
    shifted = expected + shared_error(points - expected, around)
    log_p = _noise_of(points - shifted)
    pairs = {(min(a, b), max(a, b)) for a in np.flatnonzero(tested) for b in around[a]}
    gains = {pair: _gain(points, shifted, log_p, *pair) for pair in pairs}
    half, swapped = max(1, round(0.5 * WINDOW_S * fps)), set[int]()
    # Two markers that are no neighbours swap by way of a third one. Its label is right again in the second round.
    for a, b in 2 * sorted(pairs, key=lambda pair: -gains[pair].sum(where=gains[pair] > 0)):
        gain = _gain(points, shifted, log_p, a, b) if {a, b} & swapped else gains[a, b]
        for first, last in true_runs(_smoothed(gain, half) >= BOUND):
            first, last = _trimmed(gain, first, last)
            if last < first:
                continue
            stretch = slice(first, last + 1)
            points[stretch, [a, b]] = points[stretch, [b, a]]
            flags[stretch, a] |= MARKER_SWAPPED
            flags[stretch, b] |= MARKER_SWAPPED
            faults.append(LabelFault(int(a), int(b), first, last))
            swapped |= {a, b}
    off = np.linalg.norm(points - shifted, axis=-1)
    ghosts = (np.nan_to_num(off) > GHOST_M) & tested
    for m in np.flatnonzero(ghosts.any(axis=0)):
        faults += [LabelFault(int(m), int(m), first, last) for first, last in true_runs(ghosts[:, m])]
    points[ghosts] = np.nan
    flags[ghosts] |= MARKER_GHOST
    return CleanedLabels(points, flags, tuple(sorted(faults, key=lambda fault: (fault.first, fault.marker))))


def shared_error(off: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Estimate the error (F, M, 3) in metres of the fitted body near each marker, 0 where unknown.

    It is the median of the errors ``off`` (F, M, 3) of the neighbours ``around`` (M, n) of the marker.
    """
    ordered = np.sort(off[:, around], axis=2)  # (F, M, n, 3). Missing values come last
    count = np.maximum(np.isfinite(ordered).sum(axis=2, keepdims=True), 1)
    middle = [np.take_along_axis(ordered, place, 2) for place in ((count - 1) // 2, count // 2)]
    return np.nan_to_num(0.5 * (middle[0] + middle[1])[:, :, 0])


LogDensity = Callable[[np.ndarray], np.ndarray]
"""Log density (...) in nats of errors (..., 3) in metres."""


def _noise_of(off: np.ndarray) -> LogDensity:
    """Fit the noise per axis of errors (F, M, 3) in metres: normal errors with uniform outliers (``fit_noise``)."""
    noise = fit_noise(count_in_bins(off[None] / MEAN_STATURE_M, np.ones(())))
    return lambda off: log_density(off / MEAN_STATURE_M, noise.sigma, noise.outliers).sum(-1)


def _gain(points: np.ndarray, expected: np.ndarray, log_p: LogDensity, a: int, b: int) -> np.ndarray:
    """Return the gain (F,) of swapping two labels in nats. A missing marker adds nothing."""
    crossed = log_p(points[:, [a, b]] - expected[:, [b, a]])
    return np.nan_to_num(crossed - log_p(points[:, [a, b]] - expected[:, [a, b]])).sum(-1)


def _smoothed(gain: np.ndarray, half: int) -> np.ndarray:
    total = np.concatenate([[0.0], np.cumsum(gain)])
    index = np.arange(len(gain))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(gain))
    return (total[high] - total[low]) / (high - low)


def _trimmed(gain: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """Extend a range by adjacent frames with a positive swap gain, and remove end frames without a positive gain."""
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
    """Return warnings about stationary markers, given as an (F, M) mask, and about wrong labels."""
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
    """Merge warnings about ghost points or stationary markers if they concern more than ``MOST_NAMED`` markers."""
    items = list(found)
    for code in ("marker_ghost", "marker_still"):
        alike = [item for item in items if item.code == code]
        labels = list(dict.fromkeys(label for item in alike for label in item.where.markers))
        if len(labels) <= MOST_NAMED:
            continue
        frames = {frame for item in alike for a, b in item.where.frames for frame in range(a, b + 1)}
        there = np.isin(np.arange(max(frames) + 1), list(frames))
        several = diagnostic(code, markers=labels, frames=true_runs(there), remedy=alike[0].remedy)
        items = [several if item is alike[0] else item for item in items if item is alike[0] or item.code != code]
    return items


def with_wrists_named(clouds: Sequence[MarkerCloud], own: Mapping[str, str]) -> NamesOverTakes:
    """Correct swapped wrist labels in several takes. Return the corrected takes and a record of the changes."""
    takes, changes = list(clouds), list[NameChange]()
    for number, cloud in enumerate(clouds):
        labels = cloud.labels or ()
        known = name_markers([label for label in labels if not is_unnamed(label)], own).known
        for a, b in exchanged_wrists(cloud.positions, [known.get(label, "") for label in labels]):
            if {labels[a], labels[b]} & set(own):
                continue
            takes[number] = with_exchanged(takes[number], labels[a], labels[b])
            changes.append(NameChange(number, labels[a], labels[b], mended=True))
    return NamesOverTakes(tuple(takes), tuple(changes))


FRAMES = 16  # Number of varied frames compared before a person is calibrated.
LEAST = 8  # Smallest number of frames that show both markers.


def exchanged_labels(problem: Problem, like: Array) -> list[tuple[int, int]]:
    """Find pairs of markers with swapped labels by fitting the average person.

    Markers known only by their bone have no expected position, so they are excluded.
    """
    subject = Subject.average(problem.body, problem.measurements.landmarks, like)
    frames = varied_frames(problem.measurements.points, FRAMES)
    states = fit_to_points(problem, subject, frames)
    found = to_numpy(pose(subject, posed(problem.prior, states)).points)
    on_skin = np.array([not name.startswith(ON_BONE) for name in problem.measurements.landmarks.names])
    return exchanged_throughout(np.where(on_skin[:, None], problem.measurements.points[frames], np.nan), found)


def exchanged_throughout(points: np.ndarray, expected: np.ndarray) -> list[tuple[int, int]]:
    """Find pairs of markers that are at each other's position in most frames.

    The gain of a swap is its median over frames, as in ``clean_labels``. The frames count once, because offsets are
    constant. It must lead the labels as written, and every other pair with one of its markers, by ``BOUND``. The
    expected positions y are corrected by the body's error near each marker.
    """
    around = neighbours_of(points)
    shifted = expected + shared_error(points - expected, around)
    log_p = _noise_of(points - shifted)
    own, gain = log_p(points - shifted), np.full(points.shape[1:2] * 2, -np.inf)
    for a, near in enumerate(around):
        crossed = log_p(points[:, [a]] - shifted[:, near]) + log_p(points[:, near] - shifted[:, [a]])
        gains = crossed - own[:, [a]] - own[:, near]
        seen = np.isfinite(gains).sum(axis=0) >= min(LEAST, len(points))
        gain[a, near[seen]] = gain[near[seen], a] = quantile(gains[:, seen], 0.5, axis=0)
    found: list[tuple[int, int]] = []
    for a, b in np.argwhere(np.triu(gain >= BOUND)).tolist():
        rivals = np.delete(gain[a], b).max(), np.delete(gain[b], a).max()
        found += [(a, b)] if gain[a, b] - max(rivals) >= BOUND else []
    return found


def named_alike(
    clouds: Sequence[MarkerCloud], own: Mapping[str, str]
) -> tuple[tuple[MarkerCloud, ...], dict[str, Any]]:
    """Make labels consistent across takes. Return the corrected takes, and the changes for the provenance."""
    wrists = with_wrists_named(clouds, own)
    named = names_over_takes(wrists.clouds, own)
    return named.clouds, over_takes((*wrists.changes, *named.changes))
