"""Tracklets of points that are one marker: tracks cut at jumps, joined where one continues another."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver_backend.geometry.arrays import true_runs

SPLIT_GAP_S = 0.1  # A point that is missing for longer may come back as another.
JUMP_M, JUMP_M_S2 = 0.03, 300.0
"""Largest change of a step: metres, and an acceleration that no marker on a person exceeds."""
JOIN_S, JOIN_M = 0.1, 0.02
"""Longest gap between a tracklet and its continuation, and the largest distance from the extrapolated place."""
CLEAR = 0.5  # Factor by which every other beginning is farther away than the chosen one.


@dataclass(frozen=True)
class Tracklets:
    """T tracklets of points in a cloud: column, first and last frame, and chain of tracklets that continue (T,)."""

    number: np.ndarray  # (F, N) int: tracklet of each point, -1 where there is none.
    column: np.ndarray
    first: np.ndarray
    last: np.ndarray
    chain: np.ndarray

    def __len__(self) -> int:
        return len(self.column)

    @property
    def num_chains(self) -> int:
        """Number of chains."""
        return int(self.chain.max(initial=-1)) + 1


def tracklets_of(positions: np.ndarray, fps: float, *, persistent: bool = False) -> Tracklets:
    """Return the tracklets of (F, N, 3) points in metres, NaN where missing.

    ``persistent``: each column is one marker throughout, as somebody named it, and its tracklets are one chain.
    """
    seen = np.isfinite(positions).all(-1)
    number = np.full(seen.shape, -1)
    rows: list[tuple[int, int, int]] = []
    for column in np.flatnonzero(seen.any(0)):
        for first, last in _stretches(positions[:, column], seen[:, column], fps):
            number[first : last + 1, column] = np.where(seen[first : last + 1, column], len(rows), -1)
            rows.append((int(column), first, last))
    column, first, last = np.array(rows, dtype=int).reshape(-1, 3).T
    chain = column if persistent else _chains(positions, column, first, last, fps)
    return Tracklets(number, column, first, last, np.unique(chain, return_inverse=True)[1])


def _stretches(points: np.ndarray, seen: np.ndarray, fps: float) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for first, last in true_runs(seen):
        run = points[first : last + 1]
        steps = np.diff(run, axis=0)
        sudden = np.linalg.norm(np.diff(steps, axis=0, prepend=steps[:1]), axis=-1) > JUMP_M + JUMP_M_S2 / fps**2
        # A jump makes two sudden steps: there, and on going on. The first of both is where it is cut.
        cuts = np.flatnonzero(sudden & ~np.roll(sudden, 1)) if sudden.any() else []
        edges = [first, *(first + int(c) + 1 for c in cuts), last + 1]
        found += [(a, b - 1) for a, b in pairwise(edges) if b > a]
    joined: list[tuple[int, int]] = []
    for first, last in found:
        # A point that came back soon, where it was to be expected, is the same.
        if joined and 1 < first - joined[-1][1] <= SPLIT_GAP_S * fps and _off(points, joined[-1], first) < JUMP_M:
            joined[-1] = (joined[-1][0], last)
        else:
            joined.append((first, last))
    return joined


def _off(points: np.ndarray, run: tuple[int, int], frame: int) -> float:
    a, b = run
    velocity = points[b] - points[b - 1] if b > a and np.isfinite(points[b - 1]).all() else np.zeros(3)
    return float(np.linalg.norm(points[frame] - points[b] - (frame - b) * velocity))


def _chains(positions: np.ndarray, column: np.ndarray, first: np.ndarray, last: np.ndarray, fps: float) -> np.ndarray:
    """Return the chain of each tracklet: ends meet beginnings that are near, soon and nobody else's."""
    count = len(column)
    chain = np.arange(count)
    if count < 2:
        return chain
    start, end = positions[first, column], positions[last, column]
    before = np.maximum(last - 1, first)
    velocity = np.nan_to_num(end - positions[before, column])
    soon = max(1, round(JOIN_S * fps))
    by_first = np.argsort(first, kind="stable")
    begins = first[by_first]
    follower, cost = np.full(count, -1), np.full(count, np.inf)
    for t in range(count):
        low, high = np.searchsorted(begins, (last[t] + 1, last[t] + soon + 1))
        rivals = by_first[low:high]
        if not len(rivals):
            continue
        ahead = (first[rivals] - last[t])[:, None]
        distance = np.linalg.norm(start[rivals] - end[t] - ahead * velocity[t], axis=-1)
        distance = np.minimum(distance, np.linalg.norm(start[rivals] - end[t], axis=-1))
        best, *others = np.argsort(distance)
        if distance[best] < JOIN_M and (not others or distance[best] < CLEAR * distance[others[0]]):
            follower[t], cost[t] = rivals[best], distance[best]
    for t in np.argsort(cost):
        if follower[t] < 0:
            break
        if (follower == follower[t]).sum() == 1 or cost[t] == cost[follower == follower[t]].min():
            follower[(follower == follower[t]) & (np.arange(count) != t)] = -1
    for t in np.argsort(first, kind="stable"):
        if follower[t] >= 0:
            chain[follower[t]] = chain[t]
    return chain
