"""Estimate the lags between several views or signals from tables of evidence for every pair and lag.

Callers give the tables: people in calibrated views (``people_lags``), or sound and speeds (``signal_lags``). The best
lags maximise the sum over the pairs, so that pairs which contradict the others have no effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solver_backend.agreement.evidence import (
    EACH,
    FRAMES,
    MATCHING_SHARE,
    MOST_ROUNDS,
    MOVED,
    NEIGHBOURS,
    SAMPLED_FRAMES,
    SIGMAS,
)
from solver_backend.agreement.reading import MIN_POINTS, extent
from solver_backend.cameras.camera_corrections import compared_pairs
from solver_backend.geometry.rotations import skew
from solver_backend.types import Cameras

Tables = dict[tuple[int, int], np.ndarray]
"""(2 R + 1,) gains of pairs of views i < j at offsets -R to R of j relative to i."""

LEAST_STRENGTH = 1.0
"""Smallest mean number of matching frames per pair of a camera, times the square of their share. Simulated synchronised
cameras reach 2.5 to 15, real ones with a poor calibration 1.2 to 5, unrelated cameras up to 0.5."""


def offset_profile(tables: Tables, camera: int, others: dict[int, int]) -> np.ndarray:
    """Return the total gains (4 R + 1,) of a camera at offsets -2 R to 2 R, given the offsets of other cameras."""
    reach = len(next(iter(tables.values()))) // 2
    total = np.zeros(4 * reach + 1)
    for other, offset in others.items():
        pair = min(camera, other), max(camera, other)
        if pair in tables and abs(offset) <= reach:
            table = tables[pair]
            total[reach + offset : 3 * reach + offset + 1] += table if other < camera else table[::-1]
    return total


def best_offsets(tables: Tables, count: int) -> np.ndarray:
    """Return the (C,) offsets relative to the first camera that have the largest sum of gains.

    The search starts from the best pair and adds cameras. Then each camera's offset is improved in turn (Besag 1986).
    If several offsets have the same gain, the one nearest to zero wins.
    """

    def best(gains: np.ndarray) -> int:
        at = np.flatnonzero(gains == gains.max()) - len(gains) // 2
        return int(at[np.abs(at).argmin()])

    i, j = max(tables, key=lambda pair: tables[pair].max())
    placed = {i: 0, j: best(tables[i, j])}
    while len(placed) < count:
        profiles = {c: offset_profile(tables, c, placed) for c in range(count) if c not in placed}
        c = max(profiles, key=lambda c: profiles[c].max())
        placed[c] = best(profiles[c])
    for _ in range(MOST_ROUNDS):
        before = dict(placed)
        for c in range(count):
            placed[c] = best(offset_profile(tables, c, {o: at for o, at in placed.items() if o != c}))
        if placed == before:
            break
    offsets = np.array([placed[c] for c in range(count)])
    return offsets - offsets[0]


def rival_offsets(tables: Tables, best: np.ndarray, sure: np.ndarray, near: int) -> dict[int, tuple[int, int]]:
    """Return the two best offsets of each camera that has an alternative farther than ``near`` from the best.

    Cameras are shifted singly and in pairs, because two opposite cameras may agree with the others at several offsets.
    """
    reach = 2 * (len(next(iter(tables.values()))) // 2)
    changes = np.arange(-reach, reach + 1)
    found: dict[int, tuple[int, int]] = {}
    alone = [(int(c),) for c in sure]
    for group in alone + list(combinations(sure.tolist(), 2)) * (len(sure) > 3):
        others = {int(o): int(best[o]) for o in sure if o not in group}
        total = np.zeros(len(changes))
        for c in group:
            rows = changes + reach + int(best[c])
            inside = (rows >= 0) & (rows <= 2 * reach)
            total += np.where(inside, offset_profile(tables, c, others)[np.clip(rows, 0, 2 * reach)], 0.0)
        rival = int(np.where(np.abs(changes) > near, total, -np.inf).argmax())
        if total[rival] > MATCHING_SHARE * total[reach]:
            shown = group[0] if group[0] else next(iter(others))
            change = int(changes[rival]) * (1 if group[0] else -1)
            found.setdefault(shown, (int(best[shown]), int(best[shown]) + change))
    return found


@dataclass(frozen=True)
class _ViewPeople:
    points: np.ndarray  # (F, P, J, 3) normalised points, homogeneous, 0 where unseen.
    extent: np.ndarray  # (F, P) diagonal of the person's box. Infinite if too few points are seen.

    @classmethod
    def of(cls, xy: np.ndarray) -> _ViewPeople:
        """Select the largest people in each frame of (F, P, J, 2) normalised points, NaN where missing."""
        known = np.isfinite(xy[..., 0]) & (np.isfinite(xy[..., 0]).sum(-1) >= MIN_POINTS)[..., None]
        size = extent(np.where(known[..., None], xy, np.nan))
        largest = np.argsort(-np.nan_to_num(size), axis=1, kind="stable")[:, :EACH]
        points = np.concatenate([np.where(known[..., None], xy, 0.0), known[..., None]], axis=-1)
        size = np.take_along_axis(np.where(size > 0, size, np.inf), largest, 1)
        return cls(np.take_along_axis(points, largest[..., None, None], 1), size)

    def rows(self, frames: np.ndarray) -> _ViewPeople:
        return _ViewPeople(self.points[frames], self.extent[frames])

    def lively_frames(self, count: int) -> np.ndarray:
        """Return the frame with the most movement in each of ``count`` sections of the take."""
        seen = self.points[..., 2]
        points = np.where(seen[..., None] > 0, self.points[..., :2], np.nan)
        step = np.abs(np.diff(points, axis=0, prepend=points[:1])).sum(-1)
        speed = np.nan_to_num(step).sum(axis=(1, 2)) + 1e-9 * seen.sum(axis=(1, 2))
        parts = np.array_split(np.arange(len(speed)), min(count, len(speed)))
        return np.array([part[np.argmax(speed[part])] for part in parts])


def _disagreements(cameras: Cameras, pair: tuple[int, int], a: _ViewPeople, b: _ViewPeople, scale: float) -> np.ndarray:
    """Return distances (N, G) from 0 to 1 between the people in N frames of a view and G frames of another.

    With the epipolar line ``l = E x_a / |(E x_a)_12|``, the squared distance ``(x_b' l)^2`` is the dot product of six
    numbers of ``l l'`` and of ``x_b x_b'``. One matrix product sums it over the keypoints for all pairs of frames
    (Hartley and Zisserman 2004, sec. 9.6 and 11.4). Each person is compared with the nearest one in the second view.
    The distance is NaN if no people can be compared.
    """
    i, j = pair
    R = cameras.R[j] @ cameras.R[i].T
    E = skew(cameras.t[j] - R @ cameras.t[i]) @ R
    factors = [
        (_squares(_lines(a.points, E.T)), _squares(b.points / b.extent[..., None, None])),
        (_squares(a.points / a.extent[..., None, None]), _squares(_lines(b.points, E))),
        (a.points[..., 2:], b.points[..., 2:]),
    ]
    (n, p), (g, q) = a.extent.shape, b.extent.shape
    share, back, common = (one.reshape(n * p, -1) @ two.reshape(g * q, -1).T for one, two in factors)
    share += back
    with np.errstate(invalid="ignore", divide="ignore"):
        share *= 0.5
        share /= common
        share /= share + scale**2
    share[common < MIN_POINTS] = np.inf
    nearest = share.reshape(n, p, g, q).min(-1)
    known = np.isfinite(nearest)
    with np.errstate(invalid="ignore"):
        return np.where(known, nearest, 0.0).sum(1) / np.where(known.any(1), known.sum(1), np.nan)


def _lines(points: np.ndarray, E: np.ndarray) -> np.ndarray:
    line = points @ E
    return line / np.maximum(np.linalg.norm(line[..., :2], axis=-1, keepdims=True), 1e-12)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Return the (F, P, J, 6) entries of ``v v'``, such that ``(v' w)^2`` is the dot product of two rows."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    root = np.sqrt(2.0)
    return np.stack([x * x, y * y, z * z, root * x * y, root * x * z, root * y * z], axis=-1)


@dataclass(frozen=True)
class PeopleLags:
    """Number of frames in which people match, for each pair of C views at offsets from -R to R.

    A frame's gain is its median distance over the other view's frames, minus its distance at the offset. A view without
    motion has no gain.
    """

    gains: Tables
    possible: Tables  # Largest possible gains.

    def of_cameras(self, offsets: np.ndarray, among: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return each camera's gain (C,) over all pairs, or pairs in the mask ``among``, and its possible gain."""
        found = np.zeros((2, len(offsets)))
        for (i, j), gains in self.gains.items():
            row = int(offsets[j] - offsets[i]) + len(gains) // 2
            if 0 <= row < len(gains) and (among is None or (among[i] and among[j])):
                found[:, [i, j]] += np.array([[gains[row]], [self.possible[i, j][row]]])
        return found[0], found[1]

    def strengths(self, offsets: np.ndarray) -> np.ndarray:
        """Return the (C,) matching frames of each camera per pair, times their squared share of all frames."""
        gained, possible = self.of_cameras(offsets)
        compared = [pair for pair, table in self.possible.items() if table.any()]
        pairs = np.bincount(np.ravel(compared).astype(int), minlength=len(offsets))
        return gained / np.maximum(pairs, 1) * (gained / np.maximum(possible, 1e-9)) ** 2


def people_lags(
    cameras: Cameras, xy: np.ndarray, most_samples: int = FRAMES, scale: float = MOVED, reach: int | None = None
) -> PeopleLags:
    """Compare people in pairs of views (C, F, P, J, 2) at all offsets. In large arrays, compare neighbours only.

    The ``most_samples`` frames per view with the most movement are compared with all frames of the other view within
    reach.
    """
    views, last = [_ViewPeople.of(view) for view in xy], xy.shape[1] - 1
    rows = [view.lively_frames(most_samples) for view in views]
    reach = last if reach is None else min(reach, last)
    blocks = np.array_split(np.arange(last + 1), -(-(last + 1) // SAMPLED_FRAMES))  # bounds memory
    found = PeopleLags({}, {})
    for i, j in compared_pairs(len(views), EACH, NEIGHBOURS):
        share = _disagreements(cameras, (i, j), views[i].rows(rows[i]), views[j].rows(rows[j]), scale)
        usual, table = np.full(len(share), np.nan), np.zeros((2, 2 * reach + 1))
        seen = np.isfinite(share).any(axis=1)
        usual[seen] = np.nanmedian(share[seen], axis=1)
        for block in blocks:
            offset = block - rows[i][:, None]
            near = (np.abs(offset) <= reach) & seen[:, None]
            sampled, compared = near.any(axis=1), near.any(axis=0)
            if not sampled.any():
                continue
            samples, others = views[i].rows(rows[i][sampled]), views[j].rows(block[compared])
            most, place = usual[sampled, None], (offset + reach)[sampled][:, compared]
            share = _disagreements(cameras, (i, j), samples, others, scale)
            known = np.isfinite(share) & near[sampled][:, compared]
            for row, gain in zip(table, (most - share, most + 0 * share), strict=True):
                row += np.bincount(place[known], gain[known], 2 * reach + 1)
        found.gains[i, j], found.possible[i, j] = table
    return found


@dataclass(frozen=True)
class Signal:
    """A signal with N samples of D channels."""

    values: np.ndarray  # (N, D) finite values with zero mean.
    rate_hz: float  # Samples per second.
    start_s: float = 0.0  # Time of the first sample.


@dataclass(frozen=True)
class SignalLags:
    """Clocks of C signals. Time t on the first clock is ``t + lag + rate (t - middle)`` on a signal's own clock."""

    lag_s: np.ndarray  # (C,) seconds at ``middle_s``.
    rate: np.ndarray  # (C,) seconds per second.
    covariance: np.ndarray  # (C, 2, 2) covariance of lag and rate.
    middle_s: float  # Time on the first clock.
    unknown: tuple[int, ...] = ()  # Signals outside the largest group that agrees. If there are any, all lags are 0.


LEAST_CORRELATION = 0.25  # Smallest correlation, and smallest overlap relative to the shorter signal.
RATE_SIGMA = 25e-6  # Prior standard deviation of a camera's rate. Quartz clocks stay within 50 ppm.
SAME_S = 0.05  # Lags of three pairs that differ by less agree, seconds.


def signal_lags(
    signals: Sequence[Signal], *, reach_s: float, floor_s: float, least: float = LEAST_CORRELATION
) -> SignalLags:
    """Estimate the lags and rates of C signals with the same sample rate.

    Whole signals are correlated by FFT and normalised by the energies of their overlap. Then pieces with a length of
    ``reach_s`` are correlated near the best lags. A robust fit to all pieces of all pairs, with a prior for quartz
    clocks, gives lags and rates.

    Args:
        floor_s: smallest standard deviation in seconds, such as the delay of sound or an image interval.

    Reference: Knapp and Carter 1976 (delay by correlation); Huber 1964 (the robust fit).
    """
    count, reach = len(signals), int(reach_s / SAME_S)
    middle_s = float(np.median([one.start_s + 0.5 * len(one.values) / one.rate_hz for one in signals]))
    tables = {(i, j): _lag_table(signals[i], signals[j], reach, least) for i, j in combinations(range(count), 2)}
    coarse = best_offsets(tables, count) * SAME_S
    rows, groups = list[tuple[float, ...]](), [{c} for c in range(count)]
    for (i, j), table in tables.items():
        lag = coarse[j] - coarse[i]
        agrees = abs(lag) <= reach * SAME_S and table[reach + round(lag / SAME_S)] > 0
        pieces = _piece_lags(signals[i], signals[j], lag, reach_s) if agrees else []
        if pieces:
            joined = groups[i] | groups[j]
            groups = [joined if c in joined else group for c, group in enumerate(groups)]
        rows += [(i, j, at_s - coarse[i] - middle_s, lag_s, weight) for at_s, lag_s, weight in pieces]
    if unknown := sorted({*range(count)} - max(groups, key=len)):
        return SignalLags(np.zeros(count), np.zeros(count), np.zeros((count, 2, 2)), middle_s, tuple(unknown))
    values = np.array(rows)
    sign = (values[:, 1:2] == np.arange(1, count)) * 1.0 - (values[:, :1] == np.arange(1, count))
    basis = np.concatenate([sign, sign * values[:, 2:3]], axis=1)
    x, weight = np.r_[coarse[1:], np.zeros(count - 1)], values[:, 4]
    _, pair = np.unique(values[:, :2], axis=0, return_inverse=True)
    pair = pair.reshape(-1)
    of_pair = [pair == number for number in range(pair.max() + 1)]
    prior = information = np.diag(np.repeat([0.0, RATE_SIGMA**-2], count - 1))
    for _ in range(MOST_ROUNDS):
        residual = values[:, 3] - basis @ x
        # A camera with a gap in its clock makes only its own pairs uncertain.
        off = [np.abs(residual[rows] if rows.sum() >= MIN_POINTS else residual) for rows in of_pair]
        spread = np.maximum([1.4826 * float(np.median(each)) for each in off], 1e-4)[pair]
        robust = weight**2 / np.maximum(1.0, np.abs(residual) / (SIGMAS * spread))
        # Pieces overlap by half, and of C (C - 1) / 2 pairs C - 1 are independent.
        robust = robust / max(robust.max(), 1e-12) / spread**2 / count
        information = (basis.T * robust) @ basis + prior
        x = np.linalg.solve(information, (basis.T * robust) @ values[:, 3])
    covariance, others = np.zeros((count, 2, 2)), np.arange(count - 1)
    covariance[1:] = np.linalg.inv(information).reshape(2, count - 1, 2, count - 1)[:, others, :, others]
    covariance[1:, 0, 0] += floor_s**2
    return SignalLags(np.r_[0.0, x[: count - 1]], np.r_[0.0, x[count - 1 :]], covariance, middle_s)


def _lag_table(a: Signal, b: Signal, reach: int, least: float) -> np.ndarray:
    """Return the log-likelihoods (2 R + 1,) of lags of b behind a, in steps of ``SAME_S``, 0 without correlation."""
    lags, score, overlap = _correlations(a.values, b.values)
    place = np.rint((lags / a.rate_hz + b.start_s - a.start_s) / SAME_S).astype(int) + reach
    used = (place >= 0) & (place <= 2 * reach) & (score > least)
    table = np.zeros(2 * reach + 1)
    np.maximum.at(table, place[used], -0.5 * (overlap * np.log1p(-(np.minimum(score, 0.999) ** 2)))[used])
    padded = np.pad(table, 1)  # rounded lags of three pairs differ by up to one step
    return np.maximum(table, np.maximum(padded[:-2], padded[2:]))


def _piece_lags(a: Signal, b: Signal, lag_s: float, piece_s: float) -> list[tuple[float, float, float]]:
    """Correlate pieces of a with b near a lag. Return the time and lag in seconds, and the correlation, of each."""
    rate_hz, near = a.rate_hz, 0.25 * piece_s
    size, found = max(round(piece_s * rate_hz), 8), []
    for start in range(0, max(len(a.values) - size, 0) + 1, max(size // 2, 1)):
        at_s, piece = a.start_s + start / rate_hz, a.values[start : start + size]
        begin = round((at_s + lag_s - b.start_s - near) * rate_hz)
        other = b.values[max(begin, 0) : max(begin + len(piece) + 2 * round(near * rate_hz), 0)]
        if 2 * len(other) < len(piece):
            continue
        lags, score, overlap = _correlations(piece, other)
        lags_s = (max(begin, 0) + lags) / rate_hz + b.start_s - at_s
        # Long overlaps are more reliable than short ones that agree by chance.
        best = int(np.argmax(np.where(np.abs(lags_s - lag_s) < near, score * np.sqrt(overlap), -np.inf)))
        if score[best] >= LEAST_CORRELATION and abs(lags_s[best] - lag_s) < near:
            fraction = _vertex(score[best - 1 : best + 2]) if 0 < best < len(score) - 1 else 0.0
            middle_s = at_s + 0.5 * len(piece) / rate_hz
            found.append((middle_s, float(lags_s[best]) + fraction / rate_hz, float(score[best])))
    return found


def _correlations(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return lags of b behind a in samples, and for each lag the correlation and the number of common samples."""
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    product = np.fft.irfft(np.fft.rfft(b, size, axis=0) * np.conj(np.fft.rfft(a, size, axis=0)), size, axis=0).sum(-1)
    lags = np.arange(-(len(a) - 1), len(b))
    low, high = np.maximum(0, -lags), np.minimum(len(a), len(b) - lags)
    lags, low, high = (values[high - low >= LEAST_CORRELATION * min(len(a), len(b))] for values in (lags, low, high))
    energy_a, energy_b = (np.r_[0.0, np.cumsum((v**2).sum(-1))] for v in (a, b))
    energy = (energy_a[high] - energy_a[low]) * (energy_b[high + lags] - energy_b[low + lags])
    return lags, product[lags % size] / np.sqrt(np.maximum(energy, 1e-30)), high - low


def _vertex(three: np.ndarray) -> float:
    """Return the vertex of the parabola through three values, in samples from the middle one."""
    bend = three[0] - 2 * three[1] + three[2]
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -0.5, 0.5)) if bend < 0 else 0.0
