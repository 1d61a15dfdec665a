"""Tracklets of points that are one marker, and exclusive labels: no marker has two points in a frame."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver_backend.geometry.arrays import true_runs
from solver_backend.labelling.outputs import GHOST

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

    ``persistent``: each column is one marker throughout, with a given name, and its tracklets are one chain.
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
    """Return the chain of each tracklet: ends meet near and soon beginnings of no other tracklet."""
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


_TAKEN = -1e9  # Evidence of a label that is taken: below any log-probability.
_ROUNDS, _EXCHANGES, _GAIN = 4, 200, 1e-6
"""Most rounds of exchange, most pairs of one round, and the least gain of an exchange, chosen by hand."""


def labels_of_frame(log_probability: np.ndarray) -> np.ndarray:
    """Return (N,) labels of (N, 54) log probabilities (ghost last), no marker twice, by repeated mutual best pairs."""
    scores = np.array(log_probability)
    labels = np.full(len(scores), GHOST)
    rows = np.arange(len(scores))
    for _ in range(GHOST):
        if not len(rows):
            break
        best = scores[rows].argmax(1)
        value = scores[rows, best]
        # Of the points that want a marker the surest gets it, measured against being nothing.
        surplus = value - scores[rows, GHOST]
        order = np.lexsort((-surplus, best))
        winners = order[np.unique(best[order], return_index=True)[1]]
        done = (best == GHOST) | np.isin(np.arange(len(rows)), winners)
        labels[rows[done]] = best[done]
        taken = np.unique(best[best != GHOST])
        scores[:, taken] = _TAKEN
        rows = rows[~done]
    return labels


def labels_of_stretches(evidence: np.ndarray, together: np.ndarray, bound: dict[int, int] | None = None) -> np.ndarray:
    """Return (T,) labels that maximise the evidence, none twice among tracklets that are seen together.

    The clearest tracklet chooses first, by the margin of its best free label over the next. Then pairs exchange their
    labels as long as the sum grows. Evidence is (T, 54) log likelihoods, the ghost last. ``together`` (T, T) are pairs
    that are seen at one time, ``bound`` the user's labels by tracklet.
    """
    count = len(evidence)
    labels = np.full(count, -1)
    free = np.ones((count, GHOST + 1), dtype=bool)
    for t, label in (bound or {}).items():
        labels[t] = label
        if label != GHOST:
            free[together[t], label] = False
    fixed = labels >= 0
    open_ = ~fixed
    margin = _margins(free, evidence)
    while open_.any():
        rows = np.flatnonzero(open_)
        t = rows[np.argmax(margin[rows])]
        labels[t] = int(np.argmax(np.where(free[t], evidence[t], _TAKEN)))
        open_[t] = False
        if labels[t] != GHOST:
            loses = together[t] & free[:, labels[t]]
            free[loses, labels[t]] = False
            margin[loses] = _margins(free[loses], evidence[loses])
    for _ in range(_ROUNDS):
        if not _exchanged(labels, evidence, together, fixed):
            break
    return labels


def _margins(free: np.ndarray, evidence: np.ndarray) -> np.ndarray:
    two = np.partition(np.where(free, evidence, _TAKEN), -2, axis=1)[:, -2:]
    return two[:, 1] - two[:, 0]


def _exchanged(labels: np.ndarray, evidence: np.ndarray, together: np.ndarray, fixed: np.ndarray) -> bool:
    """Exchange the labels of pairs where that is better for both together. Return whether any were."""
    own = evidence[np.arange(len(labels)), labels]
    other = evidence[:, labels]
    gain = other + other.T - own[:, None] - own[None]
    gain[~together | fixed[:, None] | fixed[None]] = 0.0
    changed = False
    better = np.flatnonzero(gain > _GAIN)
    for flat in better[np.argsort(-gain.ravel()[better])[:_EXCHANGES]]:
        a, b = np.unravel_index(flat, gain.shape)
        if gain[a, b] <= _GAIN:
            break
        if _may(labels, together, a, labels[b], b) and _may(labels, together, b, labels[a], a):
            labels[a], labels[b] = labels[b], labels[a]
            gain[[a, b]] = gain[:, [a, b]] = 0.0
            changed = True
    return changed


def _may(labels: np.ndarray, together: np.ndarray, t: np.intp, label: int, but: np.intp) -> bool:
    if label == GHOST:
        return True
    rivals = together[t] & (labels == label)
    rivals[[t, but]] = False
    return not rivals.any()
