"""Markers that sit where their names cannot mean: such names are not believed."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import ON_BONE
from solver_backend.fitters.marker_calibration.calibrate import SubjectCalibration
from solver_backend.fitters.model.subject import pose
from solver_backend.geometry.arrays import quantile, to_numpy

FARTHEST_M = {"shaft": 0.19, "hand": 0.15, "trunk": 0.15, "head": 0.15, "bone": 0.13, "foot": 0.11}
"""Largest distance of a marker from its name's place, by the kind of place: of 1,900 markers in 60 recordings, wands on
thighs and shanks reach 0.155, all others 0.13 and less, except for ``FREE_M``; chairs named like arms 0.4."""
FREE_M = {"BAC": 0.25, "SACR": 0.16}
"""The same of freely chosen places: offset markers on the back, and wands on the sacrum."""


def off_place(places: tuple[str, ...], distance: np.ndarray) -> list[int]:
    """Return the markers that sit too far from their places, by (M,) distances in metres, the farthest first.

    Markers with a bone alone, and joint centres, have no expected place.
    """
    far = [m for m, place in enumerate(places) if distance[m] > _farthest(place)]
    return sorted(far, key=lambda m: -distance[m])


def distances(found: SubjectCalibration, points: np.ndarray) -> np.ndarray:
    """Return (M,) metres: each marker's offset from its place, and its median residual where it moves otherwise."""
    away = np.linalg.norm(points[found.frames] - to_numpy(pose(found.subject, found.poses).points), axis=-1)
    residual = np.nan_to_num(quantile(away, 0.5, axis=0))
    return np.linalg.norm(to_numpy(found.subject.offsets), axis=-1) + residual


def _farthest(place: str) -> float:
    layouts = load_layouts()
    rule = layouts.midline.get(place) or layouts.sided.get(place[1:])
    if place.startswith(ON_BONE) or is_joint_centre(place) or rule is None:
        return np.inf
    bare = place if place in layouts.midline else place[1:]
    return FREE_M.get(bare, FARTHEST_M[rule["kind"]])


APART_M = 0.09
"""Least distance of a marker's places on its bone in two takes, metres. In four takes each of five of UI-PRMD's people
they differ by 11 to 20 mm (medians), shoulders by up to 85 as arms rise; between two of subject 5's both thighs'
markers were moved, by 90 and 111 mm (120 nearer to the knee in the file too)."""
STEADY = 0.25
"""Largest median distance from a take's own place, as a share of that: a marker that wanders says nothing of its
name."""
_TWISTED = ("elbow", "wrist", "hand")
"""Bones that markers do not fix well about their own axis: a forearm's twist alone moves places by 114 mm."""
LEAST_FRAMES = 4
"""Least frames of a take that show a marker."""


def two_places(found: SubjectCalibration, points: np.ndarray, takes: np.ndarray) -> list[tuple[int, float, int, int]]:
    """Return the markers that two takes show at different places, with the distance in metres and both takes.

    A marker's place in a take is the median of ``Gᵀ (x - p)`` in the frames of the calibration, with p and G of the
    bone that its landmark moves with most.

    Args:
        found: the calibration from several takes.
        points: (F, M, 3) metres of the takes one after the other, NaN where missing.
        takes: (F,) take of each frame.
    """
    subject, frames = found.subject, found.poses
    skeleton = forward_kinematics(subject.body, subject.betas, frames.root, frames.local, frames.transl)
    joints, rotations = to_numpy(skeleton.joints), to_numpy(skeleton.G)
    bones = np.argmax(subject.landmarks.weights, axis=1)
    away = points[found.frames] - joints[:, bones]
    local = (np.swapaxes(rotations[:, bones], -1, -2) @ away[..., None])[..., 0]
    take = takes[found.frames]
    numbers = [number for number in np.unique(take).tolist() if (take == number).sum() >= LEAST_FRAMES]
    parts = [local[take == number] for number in numbers]
    places = [quantile(part, 0.5, axis=0) for part in parts]
    around = [
        quantile(np.linalg.norm(part - place, axis=-1), 0.5, axis=0) for part, place in zip(parts, places, strict=True)
    ]
    seen = [np.isfinite(part).all(-1).sum(axis=0) >= LEAST_FRAMES for part in parts]
    doubts = []
    for m, bone in enumerate(bones):
        there = [i for i in range(len(numbers)) if seen[i][m]]
        pairs = [(float(np.linalg.norm(places[a][m] - places[b][m])), a, b) for a, b in combinations(there, 2)]
        if not pairs or subject.body.layout.joints[bone].endswith(_TWISTED):
            continue
        apart, a, b = max(pairs)
        if apart > APART_M and max(around[a][m], around[b][m]) < STEADY * apart:
            doubts.append((m, apart, numbers[a], numbers[b]))
    return sorted(doubts, key=lambda doubt: -doubt[1])
