"""Markers that sit elsewhere in one take of a person than in another: two with one name, or one that was moved."""

from __future__ import annotations

import numpy as np

from solver_backend.body.kinematics import forward_kinematics
from solver_backend.fitters.marker_calibration.calibrate import SubjectCalibration
from solver_backend.geometry.arrays import to_numpy
from solver_backend.geometry.quantiles import quantile

APART_M = 0.09
"""Metres between a marker's places on its bone in two takes, at least. In four takes each of five of UI-PRMD's people
they differ by 11 to 20 mm (medians), shoulders by up to 85 as arms rise; between two of subject 5's both thighs'
markers were moved, by 90 and 111 mm (120 nearer to the knee in the file too)."""
STEADY = 0.25
"""Of that distance, the median one around each take's own place at most: what wanders is no question of its name."""
_TWISTED = ("elbow", "wrist", "hand")
"""Bones that markers do not fix well about their own axis: on a forearm places differ by 114 mm by its twist alone."""
LEAST_FRAMES = 4
"""Frames of a take that have to show a marker."""


def two_places(found: SubjectCalibration, points: np.ndarray, takes: np.ndarray) -> list[tuple[int, float, int, int]]:
    """Return the markers that two takes show at different places, with the distance in metres and both takes.

    A marker's place in a take is the median of ``Gᵀ (x - p)`` in the frames of the calibration, with p and G of the
    bone that its landmark moves with most.

    Args:
        found: the calibration from several takes.
        points: (F, M, 3) metres of the takes one after the other, NaN where missing.
        takes: (F,) number of the take of each frame.
    """
    subject, frames = found.subject, found.poses
    skeleton = forward_kinematics(subject.body, subject.betas, frames.root, frames.local, frames.transl)
    joints, rotations = to_numpy(skeleton.joints), to_numpy(skeleton.G)
    bones = np.argmax(subject.landmarks.weights, axis=1)
    away = points[found.frames] - joints[:, bones]
    local = (np.swapaxes(rotations[:, bones], -1, -2) @ away[..., None])[..., 0]
    take = takes[found.frames]
    numbers = [number for number in np.unique(take) if (take == number).sum() >= LEAST_FRAMES]
    places = np.stack([quantile(local[take == number], 0.5, axis=0) for number in numbers]) if numbers else local[:0]
    around = [
        quantile(np.linalg.norm(local[take == number] - place, axis=-1), 0.5, axis=0)
        for number, place in zip(numbers, places, strict=True)
    ]
    seen = [np.isfinite(local[take == number]).all(-1).sum(axis=0) >= LEAST_FRAMES for number in numbers]
    doubts = []
    names = subject.body.layout.joints
    for m in range(points.shape[1]):
        if names[bones[m]].endswith(_TWISTED):
            continue
        there = [i for i in range(len(numbers)) if seen[i][m]]
        pairs = [(float(np.linalg.norm(places[a, m] - places[b, m])), a, b) for a in there for b in there if a < b]
        if not pairs:
            continue
        apart, a, b = max(pairs)
        if apart > APART_M and max(around[a][m], around[b][m]) < STEADY * apart:
            doubts.append((m, apart, int(numbers[a]), int(numbers[b])))
    return sorted(doubts, key=lambda doubt: -doubt[1])
