"""Two labels that are exchanged in all of a take: nothing jumps, but each marker is where the other must be."""

from __future__ import annotations

import numpy as np

from solver_backend.body.markers import ON_BONE
from solver_backend.fitters.marker_calibration.frame_choice import varied_frames
from solver_backend.fitters.marker_calibration.label_faults import shared_error
from solver_backend.fitters.model.subject import Subject, pose
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame.fit import posed
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.geometry.arrays import Array, to_numpy
from solver_backend.geometry.marker_jumps import neighbours_of

FRAMES = 16
"""Varied frames that are looked at before a person is known."""
OFF_M = 0.04
"""Both markers are at least this far from their places, in the root of the mean square of the two."""
SHARE = 0.3
"""An exchange leaves at most so much of the squared distances."""
LEAST = 8
"""Frames in which both markers are seen."""


def exchanged_labels(problem: Problem, like: Array) -> list[tuple[int, int]]:
    """Return pairs of markers that hold each other's labels, of a person who is not known yet: the mean one is fitted.

    Markers of which the bone alone is known are nowhere expected, so none of them can be elsewhere.

    Args:
        problem: markers made ready.
        like: array that sets kind, type and device.
    """
    subject = Subject.average(problem.body, problem.measurements.landmarks, like)
    frames = varied_frames(problem.measurements.points, FRAMES)
    states = fit_to_points(problem, subject, frames)
    found = to_numpy(pose(subject, posed(problem.prior, states)).points)
    on_skin = np.array([not name.startswith(ON_BONE) for name in problem.measurements.landmarks.names])
    return exchanged_throughout(np.where(on_skin[:, None], problem.measurements.points[frames], np.nan), found)


def exchanged_throughout(points: np.ndarray, expected: np.ndarray) -> list[tuple[int, int]]:
    """Return pairs (a, b) of markers each of which is where the other is expected, in the median of the frames.

    ``m(|x_a - y_b|² + |x_b - y_a|²) < s m(|x_a - y_a|² + |x_b - y_b|²)`` with the places y shifted by what the body is
    off around each marker.

    Args:
        points: (S, M, 3) metres, NaN where missing.
        expected: (S, M, 3) where a body has them.
    """
    around = neighbours_of(points)
    shifted = expected + shared_error(points - expected, around)
    pairs = np.array(sorted({(min(a, b), max(a, b)) for a, near in enumerate(around) for b in near}))
    a, b = pairs[:, 0], pairs[:, 1]
    straight, crossed = (
        ((points[:, a] - shifted[:, i]) ** 2 + (points[:, b] - shifted[:, j]) ** 2).sum(-1) for i, j in ((a, b), (b, a))
    )
    compared = np.flatnonzero(np.isfinite(straight).sum(0) >= min(LEAST, len(points)))
    straight, crossed = (np.nanmedian(part[:, compared], axis=0) for part in (straight, crossed))
    wrong = (straight > 2 * OFF_M**2) & (crossed < SHARE * straight)
    found: list[tuple[int, int]] = []
    for k in np.flatnonzero(wrong)[np.argsort(crossed[wrong] - straight[wrong])]:
        pair = int(a[compared[k]]), int(b[compared[k]])
        if not any(set(pair) & set(other) for other in found):
            found.append(pair)
    return found
