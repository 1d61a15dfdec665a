"""Group detections of the same person in different views of one frame.

Rays of every pair of detections from two views are intersected at the midpoint of their shortest segment. Pairs with
intersecting rays are projected into all other views, and the nearest detection in each is added. Distances are in
metres at the person's depth, so one tolerance fits all lenses. Each comparison also tries swapped sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from solver_backend.agreement.reading import MIN_POINTS, Sightings
from solver_backend.geometry.arrays import quantile
from solver_backend.types import Cameras

TOLERANCE_M = 0.15  # Largest median distance of the keypoints in a person's detection.
MAX_EXTENT_M = 1.6  # Largest distance of a person's keypoint from the centre.
SMALLEST_ANGLE_SIN2 = 0.0076  # Squared sine of the smallest angle between two rays that locate a point, 5 degrees.
_FRAMES_AT_A_TIME = 400  # Frames to compare at a time, which bounds memory.


@dataclass(frozen=True)
class PeopleInSpace:
    """H people, or groups of detections that may be people, each in one frame."""

    frame: np.ndarray  # (H,) frame of each, ascending.
    members: np.ndarray  # (H, C) index of each view's detection, -1 without one.
    points: np.ndarray  # (H, J, 3) world metres of the compared keypoints, NaN where unknown.
    score: np.ndarray  # (H,) sum over its views of 1 - distance / tolerance.

    def at(self, rows: np.ndarray) -> PeopleInSpace:
        """Return the selected people."""
        return PeopleInSpace(self.frame[rows], self.members[rows], self.points[rows], self.score[rows])

    @classmethod
    def joined(cls, blocks: list[PeopleInSpace]) -> PeopleInSpace:
        """Return the people of several blocks of frames."""
        rows = zip(*((b.frame, b.members, b.points, b.score) for b in blocks), strict=True)
        return cls(*(np.concatenate(values) for values in rows))


def candidates(seen: Sightings) -> Iterator[tuple[int, PeopleInSpace]]:
    """Yield the number of finished frames and all candidates, for each block of frames.

    Groups may share detections, as rays of different people can meet by chance. ``assigned_exclusively`` resolves this.
    """
    frames = seen.xy.shape[1]
    for start in range(0, frames, _FRAMES_AT_A_TIME):
        stop = min(start + _FRAMES_AT_A_TIME, frames)
        block = Sightings(seen.cameras, seen.xy[:, start:stop], seen.mirror)
        frame, points = _seeds(block)
        members, swapped, _ = gather(block, frame, points)
        several = (members >= 0).sum(1) >= 2  # each combination of detections of two views or more counts once
        rows, first = np.unique(np.column_stack([frame, members])[several], axis=0, return_index=True)
        frame, members = rows[:, 0], rows[:, 1:]
        points = _intersection(block, frame, members, swapped[several][first])
        members, _, score = gather(block, frame, points)
        yield stop, PeopleInSpace(frame + start, members, points, score).at((members >= 0).sum(1) >= 2)


def _seeds(seen: Sightings) -> tuple[np.ndarray, np.ndarray]:
    """Return frame (N,) and points (N, J, 3) of every pair of detections with intersecting rays."""
    present = seen.present()
    frames: list[np.ndarray] = [np.zeros(0, np.int64)]
    points: list[np.ndarray] = [np.zeros((0, seen.xy.shape[3], 3))]
    count = len(seen.cameras)
    for a in range(count):
        for b in range(a + 1, count):
            frame, p, q = np.nonzero(present[a][:, :, None] & present[b][:, None, :])
            first, second = seen.xy[a, frame, p], seen.xy[b, frame, q]
            for swapped in (False, True):
                middle, gap = _midpoints(seen.cameras, a, b, first, second[:, seen.mirror] if swapped else second)
                meets = _median(gap) < TOLERANCE_M
                person = meets & _is_person_sized(middle)
                frames.append(frame[person])
                points.append(middle[person])
                frame, first, second = frame[~meets], first[~meets], second[~meets]
    return np.concatenate(frames), np.concatenate(points)


def _midpoints(cameras: Cameras, a: int, b: int, n_a: np.ndarray, n_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return midpoint (N, J, 3) and length (N, J) of the shortest segment between two rays.

    Both are NaN if a keypoint is missing, the rays are nearly parallel, or they intersect behind a camera (midpoint
    method; Hartley and Sturm 1997, "Triangulation").
    """
    d_a, d_b = _directions(cameras, a, n_a), _directions(cameras, b, n_b)
    base = cameras.centres[b] - cameras.centres[a]
    along_a, along_b, cosine = d_a @ base, d_b @ base, (d_a * d_b).sum(-1)
    spread = 1.0 - cosine**2
    usable = spread > SMALLEST_ANGLE_SIN2
    spread = np.where(usable, spread, np.nan)
    s, u = (along_a - cosine * along_b) / spread, (cosine * along_a - along_b) / spread
    p_a = cameras.centres[a] + s[..., None] * d_a
    p_b = cameras.centres[b] + u[..., None] * d_b
    ahead = (s > 0) & (u > 0)
    middle = np.where(ahead[..., None], (p_a + p_b) / 2, np.nan)
    return middle, np.where(ahead, np.linalg.norm(p_a - p_b, axis=-1), np.nan)


def _directions(cameras: Cameras, c: int, n: np.ndarray) -> np.ndarray:
    """Return unit ray directions (..., 3) in the world for normalised coordinates (..., 2)."""
    ray = n @ cameras.R[c][:2] + cameras.R[c][2]
    return ray / np.sqrt(1.0 + (n * n).sum(-1))[..., None]


def gather(seen: Sightings, frame: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the detections of the person at ``points`` in all views, and their agreement.

    Args:
        frame: (N,) frame of each person.
        points: (N, J, 3) world positions in metres, NaN where unknown.

    Returns:
        Members (N, C), -1 without a detection, mask (N, C) of swapped sides, and score (N,) as in ``PeopleInSpace``.
    """
    members = np.full((len(frame), len(seen.cameras)), -1)
    swaps = np.zeros(members.shape, bool)
    score = np.zeros(len(frame))
    for c in range(len(seen.cameras)):
        fit, distance, swapped = detection_distances(seen, c, frame, points)
        best = np.argmax(np.where(distance < TOLERANCE_M, fit, -1.0), axis=1)[:, None]
        nearest = np.take_along_axis(distance, best, axis=1)[:, 0]
        members[:, c] = np.where(nearest < TOLERANCE_M, best[:, 0], -1)
        swaps[:, c] = np.take_along_axis(swapped, best, axis=1)[:, 0]
        score += np.maximum(0.0, 1.0 - nearest / TOLERANCE_M)
    return members, swaps, score


def detection_distances(
    seen: Sightings, c: int, frame: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare every detection of one view with a person in space.

    Args:
        frame: (N,) frame of each person.
        points: (N, J, 3) world positions in metres, NaN where unknown.

    Returns:
        (N, P) number of keypoints at their expected positions (a soft count), (N, P) median distance in metres at the
            person's depth, infinity for too few keypoints, and an (N, P) mask of swapped left and right.
    """
    local = points @ seen.cameras.R[c].T + seen.cameras.t[c]
    depth = np.where(local[..., 2] > 0.05, local[..., 2], np.nan)
    expected = local[..., :2] / depth[..., None]
    fits, distances, swaps = [], [], []
    for p in range(seen.xy.shape[2]):
        found = seen.xy[c, frame, p]
        fit, distance = _fit(found, expected, depth)
        swapped_fit, swapped_distance = _fit(found[:, seen.mirror], expected, depth)
        swapped = swapped_distance < distance
        swaps.append(swapped)
        fits.append(np.where(swapped, swapped_fit, fit))
        distances.append(np.where(swapped, swapped_distance, distance))
    return np.stack(fits, axis=1), np.stack(distances, axis=1), np.stack(swaps, axis=1)


def _fit(found: np.ndarray, expected: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (N,) soft count of keypoints at expected positions, and median distances."""
    across, down = found[..., 0] - expected[..., 0], found[..., 1] - expected[..., 1]
    distance = np.sqrt(across * across + down * down) * depth
    fit = np.where(distance < 2 * TOLERANCE_M, 1.0 - distance / (2 * TOLERANCE_M), 0.0).sum(-1)
    return fit, _median(distance)


def _median(values: np.ndarray) -> np.ndarray:
    """Return the median of known values over the last axis, infinity with fewer than ``MIN_POINTS``."""
    enough = np.isfinite(values).sum(-1) >= MIN_POINTS
    return np.where(enough, quantile(values, 0.5, axis=-1, method="lower"), np.inf)


def _is_person_sized(points: np.ndarray) -> np.ndarray:
    """Return an (N,) mask of people whose points are nearly all close to their centre."""
    known = np.isfinite(points[..., 0])
    count = np.maximum(known.sum(-1), 1)
    middle = np.where(known[..., None], points, 0.0).sum(-2) / count[:, None]
    far = np.linalg.norm(np.where(known[..., None], points - middle[:, None], 0.0), axis=-1) > MAX_EXTENT_M
    return far.sum(-1) <= 0.2 * count


def _intersection(seen: Sightings, frame: np.ndarray, members: np.ndarray, swapped: np.ndarray) -> np.ndarray:
    """Return the (N, J, 3) points nearest to all rays: ``Σ (I - d dᵀ) x = Σ (I - d dᵀ) c``.

    Midpoint method (Hartley and Sturm 1997, "Triangulation") for any number of views.
    """
    count, joints = len(frame), seen.xy.shape[3]
    A, b = np.zeros((count, joints, 3, 3)), np.zeros((count, joints, 3))
    used = np.zeros((count, joints), np.int64)
    for c in range(len(seen.cameras)):
        n = np.where((members[:, c] >= 0)[:, None, None], seen.xy[c, frame, members[:, c]], np.nan)
        n = np.where(swapped[:, c, None, None], n[:, seen.mirror], n)
        known = np.isfinite(n[..., 0])
        d = np.where(known[..., None], _directions(seen.cameras, c, np.nan_to_num(n)), 0.0)
        across = np.where(known[..., None, None], np.eye(3), 0.0) - d[..., :, None] * d[..., None, :]
        A += across
        b += across @ seen.cameras.centres[c]
        used += known
    # Two rays at an angle have the determinant 2 sin². More rays increase it.
    solvable = (used >= 2) & (np.linalg.det(A) > 2 * SMALLEST_ANGLE_SIN2)
    A = np.where(solvable[..., None, None], A, np.eye(3))
    return np.where(solvable[..., None], np.linalg.solve(A, b[..., None])[..., 0], np.nan)
