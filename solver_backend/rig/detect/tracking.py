"""Who is who from picture to picture of one view: detections assigned to tracks by object keypoint similarity."""

from __future__ import annotations

import numpy as np

from solver_backend.rig.detect.assignment import least_cost_assignment

SPREAD = 0.1
"""Standard deviation of a keypoint from one sight to the next, as a share of the person's size."""
LEAST_SIMILARITY = 0.05
"""Detections less similar to a track than this are somebody else."""
LOST_S = 1.0
"""A person out of sight for longer comes back under another number."""
MOST_PEOPLE = 12


def tracked(frames: list[np.ndarray], times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return who is who: places (F, P) of the detections in the picture's list, and tracks (F, P); -1 for none.

    The similarity of a detection and a track's last sight is ``mean_k exp(-d_k² / (2 s² κ²))`` over the keypoints that
    both have, s the person's size and κ ``SPREAD`` (widened with the time between); the assignment that is best in sum
    is taken.

    Args:
        frames: F arrays (N, K, 3) of x, y, confidence.
        times_s: (F,) seconds.

    Reference: Lin et al. 2014 (object keypoint similarity); Kuhn 1955 (the assignment).
    """
    last: dict[int, tuple[float, np.ndarray]] = {}
    fresh, rows = 0, []
    for people, time_s in zip(frames, times_s, strict=True):
        last = {n: seen for n, seen in last.items() if time_s - seen[0] <= LOST_S}
        order = np.argsort(-np.nansum(people[..., 2], axis=1), kind="stable")[:MOST_PEOPLE]
        numbers = _numbers(people[order], list(last.items()), float(time_s), fresh)
        fresh = max([fresh, *(n + 1 for n in numbers)])
        rows.append((order, numbers))
        last |= {n: (float(time_s), people[place]) for place, n in zip(order, numbers, strict=True)}
    most = max((len(order) for order, _ in rows), default=0)
    place, track = np.full((2, len(frames), max(most, 1)), -1)
    for f, (order, numbers) in enumerate(rows):
        place[f, : len(order)], track[f, : len(order)] = order, numbers
    return place, track


def _numbers(people: np.ndarray, known: list[tuple[int, tuple[float, np.ndarray]]], time_s: float, fresh: int) -> list:
    """Return the track's number of each person; new ones from ``fresh`` on."""
    similarity = np.zeros((len(people), len(known)))
    for j, (_, (seen_s, before)) in enumerate(known):
        similarity[:, j] = [_similarity(person, before, 1.0 + 5.0 * (time_s - seen_s)) for person in people]
    numbers = [-1] * len(people)
    for i, j in least_cost_assignment(-similarity):
        if similarity[i, j] >= LEAST_SIMILARITY:
            numbers[i] = known[j][0]
    for i, number in enumerate(numbers):
        if number < 0:
            numbers[i], fresh = fresh, fresh + 1
    return numbers


def _similarity(a: np.ndarray, b: np.ndarray, widened: float) -> float:
    common = (a[:, 2] > 0) & (b[:, 2] > 0)
    if common.sum() < 3:
        return 0.0
    size = np.hypot(*np.ptp(b[common, :2], axis=0))
    square = ((a[common, :2] - b[common, :2]) ** 2).sum(axis=1)
    return float(np.exp(-square / (2.0 * (SPREAD * widened * max(size, 1.0)) ** 2)).mean())
