"""Which frames of a take deserve a key: laid where the take is worst without, then moved to where they serve best."""

from __future__ import annotations

from bisect import bisect_left
from itertools import pairwise
from typing import Protocol

import numpy as np

from .sparse_curves import SparseCurves

_MOVES = (1, -1, 2, -2, 4, -4)
"""Candidates by which a key is moved on trial."""
_SWEEPS = 4
_NEIGHBOURS = 3
"""Keys on either side of a moved one that are fitted anew with it; the fit feels one farther off to a hundredth."""
_POWER = 6
"""Of the mean of distances that keys are moved to lessen: near the largest distance, and smooth."""
_SHARE = 8
"""In each pass over the take one in so many of the missing keys is laid."""


class Distance(Protocol):
    """How far found values are from a take."""

    def __call__(self, first: int, found: np.ndarray) -> np.ndarray:
        """Return (n,) metres for values (n, N) of the frames from ``first`` on."""
        ...


def reduce_keys(values: np.ndarray, candidates: np.ndarray, count: int, distance: Distance) -> SparseCurves:
    """Return curves with at most ``count`` keys, laid where the take needs them.

    Args:
        values: (F, N) whole curves.
        candidates: (C,) frames at which a key may lie, ascending; the first and last frame always may.
        count: keys, at least 2.
        distance: how far curves are from the take.
    """
    last = len(values) - 1
    free = np.unique(np.concatenate([candidates[(candidates > 0) & (candidates < last)], [0, last]]).astype(int))
    return SparseCurves.fitted(values, _move(values, free, _lay(values, free, count, distance), distance))


def keys_within(values: np.ndarray, distance: Distance, tolerance_m: float) -> SparseCurves:
    """Return curves that are nowhere further from a take than a tolerance, with as few keys as are found to do.

    Keys are laid at the worst frames until all are near enough; then each that is not needed goes.

    Args:
        values: (F, N) whole curves.
        distance: how far curves are from the take.
        tolerance_m: metres.
    """
    free, count = np.arange(len(values)), 2
    keys = free[[0, -1]] if len(values) > 1 else free
    while len(keys) < len(free):
        error = distance(0, SparseCurves.fitted(values, keys).sampled(len(values)))
        if error.max() <= tolerance_m:
            break
        pieces = [(a, b) for a, b in pairwise(keys.tolist()) if error[a : b + 1].max() > tolerance_m]
        worst = [int(a + error[a : b + 1].argmax()) for a, b in pieces]
        laid = [frame if a < frame < b else int((a + b) // 2) for frame, (a, b) in zip(worst, pieces, strict=True)]
        keys = np.union1d(keys, [frame for frame, (a, b) in zip(laid, pieces, strict=True) if a < frame < b])
        if len(keys) == count:
            break
        count = len(keys)
    return SparseCurves.fitted(values, _pruned(values, keys, distance, tolerance_m))


def _pruned(values: np.ndarray, keys: np.ndarray, distance: Distance, tolerance_m: float) -> np.ndarray:
    """Return the keys without those that the curves stay within the tolerance without; measured by their neighbours."""
    taken = keys.tolist()
    k = 1
    while k < len(taken) - 1:
        first, stop = max(0, k - _NEIGHBOURS), min(len(taken), k + _NEIGHBOURS + 1)
        around = [*taken[first:k], *taken[k + 1 : stop]]
        start, part = around[0], values[around[0] : around[-1] + 1]
        found = SparseCurves.fitted(part, np.array(around) - start).sampled(len(part))
        if distance(start, found).max() <= tolerance_m:
            without = np.array([*taken[:k], *taken[k + 1 :]])
            # What lies beyond the neighbours feels it, too, if little: the whole take decides.
            if distance(0, SparseCurves.fitted(values, without).sampled(len(values))).max() <= tolerance_m:
                taken.pop(k)
                continue
        k += 1
    return np.array(taken)


def _lay(values: np.ndarray, free: np.ndarray, count: int, distance: Distance) -> np.ndarray:
    """Return keys, added at the worst frames of the worst pieces until there are enough or no frame is left."""
    keys = free[[0, -1]] if len(values) > 1 else free
    while len(keys) < min(count, len(free)):
        error = distance(0, SparseCurves.fitted(values, keys).sampled(len(values)))
        open_frames = np.setdiff1d(free, keys)
        pieces = np.searchsorted(keys, open_frames)
        best: dict[int, tuple[float, int]] = {}
        for piece in np.unique(pieces).tolist():
            worst = keys[piece - 1] + int(error[keys[piece - 1] : keys[piece] + 1].argmax())
            inside = open_frames[pieces == piece]
            best[piece] = float(error[worst]), int(inside[np.abs(inside - worst).argmin()])
        ranked = sorted(best.values(), reverse=True)[: max(1, (count - len(keys)) // _SHARE)]
        keys = np.union1d(keys, [frame for _, frame in ranked])
    return keys


def _move(values: np.ndarray, free: np.ndarray, keys: np.ndarray, distance: Distance) -> np.ndarray:
    """Return the keys after moving each to a candidate nearby as long as that lessens the distances around it."""
    taken = keys.tolist()
    for _ in range(_SWEEPS):
        before = list(taken)
        for k in range(1, len(taken) - 1):
            first, stop = max(0, k - _NEIGHBOURS), min(len(taken), k + _NEIGHBOURS + 1)
            around = taken[first:stop]
            least = _cost(values, around, distance)
            at = bisect_left(free, taken[k])
            for index in (at + move for move in _MOVES if 0 <= at + move < len(free)):
                if not taken[k - 1] < free[index] < taken[k + 1]:
                    continue
                tried = [*taken[first:k], int(free[index]), *taken[k + 1 : stop]]
                cost = _cost(values, tried, distance)
                if cost < least:
                    least, taken[k] = cost, int(free[index])
        if taken == before:
            break
    return np.array(taken)


def _cost(values: np.ndarray, keys: list[int], distance: Distance) -> float:
    """Return the sum of powers of the distances between the first and the last of some keys."""
    first, stop = keys[0], keys[-1] + 1
    part = values[first:stop]
    found = SparseCurves.fitted(part, np.array(keys) - first).sampled(len(part))
    return float((distance(first, found) ** _POWER).sum())
