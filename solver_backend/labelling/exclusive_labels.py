"""Exclusive labels: no marker has two points in a frame, or two tracklets that are seen together."""

from __future__ import annotations

import numpy as np

from solver_backend.labelling.outputs import GHOST

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
