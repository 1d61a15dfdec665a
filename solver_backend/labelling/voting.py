"""What each chain of stretches is: the network's word, distances to the others and a body's place, weighed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.markers import marker_layout
from solver_backend.labelling.exclusive_labels import labels_of_stretches
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.labelling.tracklets import Tracklets

UNKNOWN = -1
"""Label of a point that nobody dares to name."""
MEMORY_S = 0.15
"""Readings nearer in time than this have the same error, and count as one."""
NETWORK_MOST = 4.0
"""Most readings that the network's word counts as: what it takes a marker for, it takes it for throughout a take."""
DISTANCE_SHARE = 1.5
"""Weight of the distances."""
BODY_SHARE, BODY_MOST = 0.3, 2.5
"""Weight of the body's word against one reading, and the most readings it counts as."""
PASSING, PASSING_S = 5.0, 0.4
"""Log likelihood by which what is seen for a moment is none of the markers, and how soon that fades."""
SELDOM = np.array([i for i, name in enumerate(MARKERS) if name not in marker_layout("CMU_41")])
SELDOM_COST = 1.5
"""Markers that common layouts lack, and by how much they are less likely beforehand."""
SURE = 0.8
"""Probability that a label needs to stand."""
TRUSTED = 0.6
"""Probability of labels whose chains help to name the others."""
FIRST_AGREED, AGREED = 0.5, 0.4
"""Mean probability by the network that these need besides: at first, and always where a body is laid over them."""


_ROWS = 512
"""Stretches that are compared with all others at once."""


@dataclass(frozen=True)
class Votes:
    """The network's votes on C chains in K frames."""

    frames: np.ndarray
    """(K,) frames read."""
    evidence: np.ndarray
    """(C, 54) sums of log probabilities."""
    mean: np.ndarray
    """(C, 54) mean probabilities."""
    count: np.ndarray
    """(C,) readings."""


def voted(
    votes: Votes, together: np.ndarray, fps: float, bound: dict[int, int], by_distance: np.ndarray | None = None,
    by_body: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return label and confidence of every chain: ``UNKNOWN`` where no label is probable enough.

    Log likelihoods add up: the network's mean word times the readings it counts as, the distances to others, a body's
    word, and what is known beforehand.

    Args:
        votes: the network's.
        together: (C, C) chains that are seen at one time.
        fps: of the take.
        bound: labels assigned by the user, by chain.
        by_distance: (C, 54), see ``distance_evidence``.
        by_body: (C, 54), see ``body_evidence``.
    """
    between = np.median(np.diff(votes.frames)) / fps if len(votes.frames) > 1 else 1.0
    seconds = votes.count * between
    readings = np.minimum(np.minimum(votes.count, seconds / MEMORY_S), NETWORK_MOST)
    evidence = (readings / np.maximum(votes.count, 1.0))[:, None] * votes.evidence
    if by_distance is not None:
        evidence = evidence + DISTANCE_SHARE * by_distance
    if by_body is not None:
        evidence = evidence + np.minimum(BODY_SHARE * seconds / MEMORY_S, BODY_MOST)[:, None] * by_body
    evidence[:, SELDOM] -= SELDOM_COST
    evidence[:, GHOST] += PASSING * np.exp(-seconds / PASSING_S)
    # Where two want one marker, it is the one that is seen longer: most points are right then.
    labels = labels_of_stretches((seconds + PASSING_S)[:, None] * evidence, together, bound)
    free = _free_of_others(labels, together)
    open_ = np.where(free, evidence, -np.inf)
    shifted = np.exp(open_ - open_.max(1, keepdims=True))
    rows = np.arange(len(labels))
    sure = shifted[rows, labels] / shifted.sum(1)
    keep = (sure >= SURE) & (votes.count > 0)
    keep[list(bound)], sure[list(bound)] = True, 1.0
    return np.where(keep, labels, UNKNOWN), sure


def _free_of_others(labels: np.ndarray, together: np.ndarray) -> np.ndarray:
    """Return (C, 54) whether each label could be a chain's: no chain that is seen with it has that label."""
    held = np.zeros((len(labels), GHOST + 1), dtype=np.int64)
    held[np.arange(len(labels)), labels] = 1
    free = (together.astype(np.int64) @ held) == 0
    free[:, GHOST] = True
    free[np.arange(len(labels)), labels] = True
    return free


def seen_together(tracklets: Tracklets) -> np.ndarray:
    """Return (C, C) whether two chains have stretches that are seen at one time."""
    first, last, chain = tracklets.first, tracklets.last, tracklets.chain
    together = np.zeros((tracklets.num_chains,) * 2, dtype=bool)
    for start in range(0, len(first), _ROWS):
        rows = slice(start, start + _ROWS)
        a, b = np.nonzero((first[rows, None] <= last) & (first <= last[rows, None]))
        together[chain[rows][a], chain[b]] = True
    np.fill_diagonal(together, False)
    return together
