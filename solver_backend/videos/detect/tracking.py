"""Who is who from picture to picture of one view: detections assigned to tracks by object keypoint similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.videos.detect.assignment import least_cost_assignment

SPREAD = 0.1
"""Standard deviation of a keypoint from one sight to the next, as a share of the person's size."""
WIDENING = 5.0
"""By so many times the spread grows in a second."""
LEAST_SIMILARITY = 0.05
"""Detections less similar to a track than this are somebody else."""
LOST_S = 1.0
"""A person out of sight for longer comes back under another number."""
MOST_PEOPLE = 12
"""People of a picture that are followed, the most confident; chosen by hand."""


def tracked(frames: list[np.ndarray], times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return who is who: places (F, P) of the detections in the picture's list, and tracks (F, P); -1 for none.

    The similarity of a detection and a track is ``mean_k exp(-d_k² / (2 s² κ²))`` over the keypoints that both have, d
    the distance to the last sight moved on by its velocity, s the person's size and κ ``SPREAD``, widened with the time
    between; the assignment that is best in sum is taken.

    Args:
        frames: F arrays (N, K, 3) of x, y, confidence.
        times_s: (F,) seconds.

    Reference: Lin et al. 2014 (object keypoint similarity); Kuhn 1955 (the assignment).
    """
    last: dict[int, _Sight] = {}
    fresh, rows = 0, []
    for people, time_s in zip(frames, times_s.tolist(), strict=True):
        last = {n: sight for n, sight in last.items() if time_s - sight.time_s <= LOST_S}
        order = np.argsort(-np.nansum(people[..., 2], axis=1), kind="stable")[:MOST_PEOPLE]
        numbers = _numbers(people[order], last, time_s, fresh)
        fresh = max([fresh, *(n + 1 for n in numbers)])
        rows.append((order, numbers))
        last |= {n: _Sight.of(people[i], time_s, last.get(n)) for i, n in zip(order, numbers, strict=True)}
    most = max((len(order) for order, _ in rows), default=0)
    place, track = np.full((2, len(frames), max(most, 1)), -1)
    for f, (order, numbers) in enumerate(rows):
        place[f, : len(order)], track[f, : len(order)] = order, numbers
    return place, track


@dataclass(frozen=True)
class _Sight:
    """A person when last seen."""

    time_s: float
    person: np.ndarray
    """(K, 3)."""
    velocity: np.ndarray
    """(2,) px a second, of the middle."""

    @classmethod
    def of(cls, person: np.ndarray, time_s: float, before: _Sight | None) -> _Sight:
        velocity = np.zeros(2)
        if before is not None and time_s > before.time_s:
            both = (person[:, 2] > 0) & (before.person[:, 2] > 0)
            if both.any():
                way = np.median(person[both, :2] - before.person[both, :2], axis=0)
                velocity = 0.5 * before.velocity + 0.5 * way / (time_s - before.time_s)
        return cls(time_s, person, velocity)

    def similarity(self, person: np.ndarray, time_s: float) -> float:
        """Return the similarity of somebody to where this person should be by now, 0 to 1."""
        both = (person[:, 2] > 0) & (self.person[:, 2] > 0)
        if both.sum() < 3:
            return 0.0
        gone_s = time_s - self.time_s
        expected = self.person[both, :2] + self.velocity * gone_s
        size = max(float(np.hypot(*np.ptp(expected, axis=0))), 1.0)
        square = ((person[both, :2] - expected) ** 2).sum(axis=1)
        return float(np.exp(-square / (2.0 * (SPREAD * (1.0 + WIDENING * gone_s) * size) ** 2)).mean())


def _numbers(people: np.ndarray, last: dict[int, _Sight], time_s: float, fresh: int) -> list[int]:
    """Return the track's number of each person; new ones from ``fresh`` on."""
    known = list(last)
    similarity = np.array([[last[n].similarity(person, time_s) for n in known] for person in people])
    similarity = similarity.reshape(len(people), len(known))
    numbers = [-1] * len(people)
    for i, j in least_cost_assignment(-similarity):
        if similarity[i, j] >= LEAST_SIMILARITY:
            numbers[i] = known[j]
    for i, number in enumerate(numbers):
        if number < 0:
            numbers[i], fresh = fresh, fresh + 1
    return numbers
