"""Offsets of cameras to the frame: the few around those found over the whole take, on more frames and finer scales."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.camera_pairs import compared_pairs
from solver_backend.people.frame_agreement import ViewPeople, moment_disagreements
from solver_backend.people.pair_gains import EACH, NEIGHBOURS, lively_frames, people_of_views
from solver_backend.types import Cameras

OFF_LINE = 0.015
"""Scale of the penalty in the person's extent: 2 cm, about a detector's error."""
REACH = 4
"""Frames on either side that are tried."""
_SAMPLES, _ROUNDS = 400, 8


def refine_starts(cameras: Cameras, xy: np.ndarray, offsets: np.ndarray, reach: int = REACH) -> np.ndarray:
    """Return offsets at which the views agree best among those nearby.

    Descends along one camera after the other; the first stays.

    Args:
        cameras: C cameras.
        xy: (C, F, P, J, 2) normalised points, NaN where missing.
        offsets: (C,) frames, see ``find_starts``.
        reach: frames on either side that are tried.
    """
    views = people_of_views(xy)
    rows = [lively_frames(view, _SAMPLES) for view in views]
    changes = np.arange(-2 * reach, 2 * reach + 1)
    tables = {
        (i, j): _costs(cameras, (i, j), (views[i], views[j]), rows[i], int(offsets[j] - offsets[i]) + changes)
        for i, j in compared_pairs(len(views), EACH, NEIGHBOURS)
    }
    moved = np.zeros(len(views), int)
    tried = np.arange(-reach, reach + 1)
    for _ in range(_ROUNDS):
        before = moved.copy()
        for c in range(1, len(views)):
            total = np.zeros(len(tried))
            for (i, j), table in tables.items():
                if c in (i, j):
                    between = tried - moved[i] if c == j else moved[j] - tried
                    total += table[np.clip(between + 2 * reach, 0, 4 * reach)]
            moved[c] = tried[total.argmin()]
        if (moved == before).all():
            break
    return offsets + moved


def _costs(
    cameras: Cameras, pair: tuple[int, int], views: tuple[ViewPeople, ViewPeople], rows: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """Return (L,) disagreements of a pair summed over the moments that all (L,) offsets leave in common."""
    at = rows[:, None] + offsets
    rows = rows[((at >= 0) & (at < len(views[1].extent))).all(axis=1)]
    if not len(rows):
        return np.zeros(len(offsets))
    first = views[0].rows(rows)
    shares = np.stack([
        moment_disagreements(cameras, *pair, first, views[1].rows(rows + offset), OFF_LINE) for offset in offsets
    ])  # fmt: skip
    known = np.isfinite(shares).all(axis=0)
    return shares[:, known].sum(axis=1)
