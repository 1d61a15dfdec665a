"""When two recordings of the same hands began: by how fast each turns its wrists, whatever axes it counts in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.geometry.rotations import log_so3
from solver_backend.types.shapes import Float

RATE = 100.0
"""Samples a second of both speeds: twice what hands move within (Winter 2009: 99 % of motion is below 15 Hz)."""
_SMOOTHED_S = 0.06
"""Seconds that speeds are averaged over."""
_OVERLAP_S, _OVERLAP = 2.0, 0.5
"""Seconds, and share of the shorter recording, that both cover at least."""
STILL_RAD_S = 0.15
"""Root mean square of a wrist's speed below which it shows no time."""
_APART_S = 0.5
"""Seconds from which another offset is another one."""


@dataclass(frozen=True)
class WristClock:
    """When one recording begins in the other."""

    offset_s: float
    """Seconds of the one at which the other begins."""
    agreement: float
    """Correlation of the speeds there."""
    next_best: float
    """The highest correlation at an offset that is clearly another."""
    certainty: float
    """Standard deviations by which the correlation is above that of recordings that have nothing to do with each other:
    ``atanh(r) sqrt(n' - 3)`` of n' independent samples (Fisher 1915; Bartlett 1946)."""


def wrist_speeds(rotations: Float[np.ndarray, "n 3 3"], times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return angular speeds, ``RATE`` a second, rad/s; NaN where no two rotations are known.

    Args:
        rotations: (F, 3, 3) in any world and axes.
        times: (F,) seconds, rising.
    """
    steps = np.linalg.norm(log_so3(np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:]), axis=-1) / np.diff(times)
    middles = 0.5 * (times[1:] + times[:-1])
    even = np.arange(times[0], times[-1], 1.0 / RATE)
    known = np.isfinite(steps)
    if known.sum() < 2:
        return np.full(len(even), np.nan)
    width = max(1, round(_SMOOTHED_S * RATE))
    speeds = np.interp(even, middles[known], steps[known])
    return np.convolve(speeds, np.full(width, 1.0 / width), mode="same")


def find_wrist_clock(one: list[np.ndarray], other: list[np.ndarray]) -> WristClock | None:
    """Return when the other recording begins in the one; None where no wrist moves, or they are too short.

    The correlation of the speeds of all wrists over what both cover, at its highest of all offsets, between samples by
    a parabola.

    Args:
        one: speeds (n,) of each wrist, ``RATE`` a second.
        other: speeds (m,) of the same wrists.
    """
    pairs = [(a, b) for a, b in zip(one, other, strict=True) if _moves(a) and _moves(b)]
    if not pairs:
        return None
    n, m = len(pairs[0][0]), len(pairs[0][1])
    least = max(round(_OVERLAP_S * RATE), round(_OVERLAP * min(n, m)))
    if min(n, m) < least:
        return None
    scores = np.mean([_correlations(a, b, least) for a, b in pairs], axis=0)
    offsets = np.arange(least - m, n - least + 1)
    best = int(scores.argmax())
    apart = np.abs(offsets - offsets[best]) > _APART_S * RATE
    agreement, at = float(scores[best]), int(offsets[best])
    samples = sum(_independent(a[max(at, 0) : at + m], b[max(-at, 0) : n - at]) for a, b in pairs)
    certainty = np.arctanh(min(agreement, 1.0 - 1e-9)) * np.sqrt(max(samples - 3.0, 0.0))
    offset = (at + _vertex(scores, best)) / RATE
    return WristClock(offset, agreement, float(scores[apart].max(initial=0.0)), float(certainty))


def _independent(a: np.ndarray, b: np.ndarray) -> float:
    """Return how many independent samples two series of n are worth: ``n / Σ_k ρ_a(k) ρ_b(k)``, of autocorrelations."""
    n = len(a)
    size = 1 << int(np.ceil(np.log2(2 * n)))
    power = [np.abs(np.fft.rfft(x - x.mean(), size)) ** 2 for x in (a, b)]
    own, other = (np.fft.irfft(p, size) for p in power)
    return n / max(float((own * other).sum() / (own[0] * other[0])), 1.0)


def _moves(speeds: np.ndarray) -> bool:
    return bool(len(speeds)) and bool(np.isfinite(speeds).all()) and float(np.sqrt((speeds**2).mean())) > STILL_RAD_S


def _correlations(a: np.ndarray, b: np.ndarray, least: int) -> np.ndarray:
    """Return the correlation of what both cover at every offset of b in a, from ``least - m`` to ``n - least``.

    Sums over the common part come from cumulated ones, products from a convolution by Fourier transform.
    """
    n, m = len(a), len(b)
    size = 1 << int(np.ceil(np.log2(n + m)))
    products = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    offsets = np.arange(least - m, n - least + 1)
    first, last = np.maximum(offsets, 0), np.minimum(offsets + m, n)
    count = last - first

    def total(values: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return sums[stop] - sums[start]

    mean_a, mean_b = total(a, first, last) / count, total(b, first - offsets, last - offsets) / count
    var_a = total(a * a, first, last) / count - mean_a**2
    var_b = total(b * b, first - offsets, last - offsets) / count - mean_b**2
    together = products[offsets % size] / count - mean_a * mean_b
    return together / np.sqrt(np.maximum(var_a, 1e-12) * np.maximum(var_b, 1e-12))


def _vertex(scores: np.ndarray, best: int) -> float:
    """Return where the parabola through the highest score and its neighbours is highest, in samples."""
    if not 0 < best < len(scores) - 1:
        return 0.0
    before, here, after = scores[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    return 0.0 if bend >= 0 else float(0.5 * (before - after) / bend)
