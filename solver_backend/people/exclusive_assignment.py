"""Of all groups of detections that may be people, those that are: each detection is one person's."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from solver_backend.people.view_agreement import PeopleInSpace


def concatenated(blocks: list[PeopleInSpace]) -> PeopleInSpace:
    """Return the people of several blocks of frames as one."""
    return PeopleInSpace(
        np.concatenate([b.frame for b in blocks]),
        np.concatenate([b.members for b in blocks]),
        np.concatenate([b.points for b in blocks]),
        np.concatenate([b.score for b in blocks]),
    )


def assigned_exclusively(people: PeopleInSpace, tracks: np.ndarray) -> PeopleInSpace:
    """Return the best groups that share no detection, by frame.

    A group's score is multiplied by how often its views' tracks agree over the whole take: the rays of two different
    people meet in some frames, those of one person in all.

    Args:
        people: groups of all frames.
        tracks: (C, F, P) number of the view's own track each detection belongs to.
    """
    score = people.score * _lasting_agreement(people, tracks)
    left = np.ones(len(score), bool)
    chosen = np.zeros(len(score), bool)
    order = np.lexsort([-score, people.frame])
    while left.any():
        open_rows = order[left[order]]
        winners = open_rows[np.unique(people.frame[open_rows], return_index=True)[1]]
        chosen[winners] = True
        taken = np.full((int(people.frame.max()) + 1, people.members.shape[1]), -2)
        taken[people.frame[winners]] = people.members[winners]
        left &= ~((people.members == taken[people.frame]) & (people.members >= 0)).any(1)
    keep = order[chosen[order]]
    return PeopleInSpace(people.frame[keep], people.members[keep], people.points[keep], people.score[keep])


def _lasting_agreement(people: PeopleInSpace, tracks: np.ndarray) -> np.ndarray:
    """Return (H,) mean over the pairs of a group's views of the share of frames in which their tracks agree."""
    views = people.members.shape[1]
    first, last = _spans(tracks)
    number = np.where(people.members >= 0, tracks[np.arange(views), people.frame[:, None], people.members], -1)
    total, pairs = np.zeros(len(people.frame)), np.zeros(len(people.frame))
    for a, b in combinations(range(views), 2):
        rows = np.flatnonzero((number[:, a] >= 0) & (number[:, b] >= 0))
        if not len(rows):
            continue
        i, j = number[rows, a], number[rows, b]
        # A pair may be part of several groups of one frame and counts once.
        once = np.unique(np.column_stack([people.frame[rows], i, j]), axis=0)[:, 1:]
        kinds, agreed = np.unique(once, axis=0, return_counts=True)
        together = (
            np.minimum(last[kinds[:, 0]], last[kinds[:, 1]]) - np.maximum(first[kinds[:, 0]], first[kinds[:, 1]]) + 1
        )
        share = (agreed + 0.5) / (together + 1.5)
        keys = kinds[:, 0] * len(first) + kinds[:, 1]
        total[rows] += share[np.searchsorted(keys, i * len(first) + j)]
        pairs[rows] += 1
    return total / np.maximum(pairs, 1)


def _spans(tracks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and last frame of each track, which has no gaps."""
    size = int(tracks.max(initial=-1)) + 1
    first, last = np.full(size, tracks.shape[1]), np.full(size, -1)
    _, frame, _ = np.nonzero(tracks >= 0)
    number = tracks[tracks >= 0]
    np.minimum.at(first, number, frame)
    np.maximum.at(last, number, frame)
    return first, last
