"""A take with few keys: some of the solver's own, joined by smooth curves that stay as near to the take as they can."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

_PULL = 1e-3
"""Weight that draws slopes to those of their neighbours, so that keys side by side have one too."""


@dataclass(frozen=True)
class SparseCurves:
    """N curves of cubic pieces that share K keys, smooth across them (cubic Hermite splines)."""

    frames: np.ndarray
    """(K,) frames of the take, ascending."""
    values: np.ndarray
    """(K, N) at the keys: those of the take."""
    slopes: np.ndarray
    """(K, N) per frame."""

    def sampled(self, num_frames: int) -> np.ndarray:
        """Return the (F, N) values on every frame of the take."""
        if len(self.frames) == 1:
            return np.repeat(self.values, num_frames, axis=0)
        left, basis = _hermite(self.frames, num_frames)
        at_left, at_right, slope_left, slope_right = basis.T[..., None]
        ends = at_left * self.values[left] + at_right * self.values[left + 1]
        return ends + slope_left * self.slopes[left] + slope_right * self.slopes[left + 1]


def reduce_keys(values: np.ndarray, candidates: np.ndarray, count: int, lever_m: np.ndarray) -> SparseCurves:
    """Return curves with at most ``count`` keys, laid where the take needs them.

    Args:
        values: (F, N) whole curves.
        candidates: (C,) frames at which a key may lie, ascending; the first and last frame always may.
        count: keys, at least 2.
        lever_m: (N,) metres by which a unit of each curve moves the body, to compare curves with.
    """
    if len(values) == 1:
        return SparseCurves(np.zeros(1, int), values, np.zeros_like(values))
    frames = choose_keys(values * lever_m, candidates, count)
    return SparseCurves(frames, values[frames], fit_slopes(values, frames))


def choose_keys(values: np.ndarray, candidates: np.ndarray, count: int) -> np.ndarray:
    """Return frames of keys: the piece that fits worst is split, at the candidate nearest to its worst frame.

    Args:
        values: (F, N) curves in comparable units.
        candidates: (C,) frames, ascending.
        count: keys at most.
    """
    last = len(values) - 1
    keys = {0, last}
    pieces = [_piece(values, candidates, 0, last)]
    while len(keys) < count and pieces:
        _, split, first, stop = heapq.heappop(pieces)
        if split < 0:
            continue
        keys.add(split)
        heapq.heappush(pieces, _piece(values, candidates, first, split))
        heapq.heappush(pieces, _piece(values, candidates, split, stop))
    return np.array(sorted(keys))


def fit_slopes(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return the (K, N) slopes at the keys with the least squared distance of the curves from ``values`` (F, N).

    A piece is linear in its two slopes, so the normal equations are tridiagonal and the same for all curves.
    """
    left, basis = _hermite(frames, len(values))
    at_keys = values[frames]
    rest = values - basis[:, :1] * at_keys[left] - basis[:, 1:2] * at_keys[left + 1]
    normal = np.zeros((len(frames), len(frames)))
    right = np.zeros_like(at_keys)
    for side in (0, 1):
        np.add.at(right, left + side, basis[:, 2 + side, None] * rest)
        for other in (0, 1):
            np.add.at(normal, (left + side, left + other), basis[:, 2 + side] * basis[:, 2 + other])
    pull = _PULL * max(1.0, float(normal.diagonal().mean()))
    usual = np.gradient(at_keys, frames, axis=0)
    return np.linalg.solve(normal + pull * np.eye(len(frames)), right + pull * usual)


def _piece(values: np.ndarray, candidates: np.ndarray, first: int, last: int) -> tuple[float, int, int, int]:
    """Return a piece for the heap: minus its largest distance from its best cubic, where to split it, and its ends.

    -1 stands for a piece that cannot be split.
    """
    inside = candidates[np.searchsorted(candidates, first, "right") : np.searchsorted(candidates, last)]
    if not len(inside):
        return 0.0, -1, first, last
    part = values[first : last + 1]
    u = np.linspace(0, 1, len(part))[:, None]
    rest = part - (1 - u) * part[0] - u * part[-1]
    bumps = np.concatenate([u * (1 - u), u * (1 - u) * (2 * u - 1)], axis=1)
    fit = bumps @ np.linalg.lstsq(bumps, rest, rcond=None)[0]
    distance = np.linalg.norm(rest - fit, axis=1)
    worst = first + int(distance.argmax())
    return -float(distance.max()), int(inside[np.abs(inside - worst).argmin()]), first, last


def _hermite(frames: np.ndarray, num_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the key before each frame (F,) and the weights (F, 4) of both values and both slopes around it."""
    at = np.arange(num_frames)
    left = np.clip(np.searchsorted(frames, at, "right") - 1, 0, len(frames) - 2)
    length = (frames[left + 1] - frames[left]).astype(float)
    u = (at - frames[left]) / length
    value_right = u * u * (3 - 2 * u)
    slopes = length * u * (1 - u) * (1 - u), -length * u * u * (1 - u)
    return left, np.stack([1 - value_right, value_right, *slopes], axis=1)
