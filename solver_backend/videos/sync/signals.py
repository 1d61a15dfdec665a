"""Estimate lag and drift of two signals by correlation of the wholes, then of pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import MocapError

LEAST_CORRELATION = 0.25  # Least correlation of pieces and wholes.
LEAST_OVERLAP = 0.3  # Least overlap of a lag, as a share of the shorter signal.
RATE_SIGMA = 25e-6  # Prior deviation of a camera's rate: quartz keeps within 50 ppm.
ROUNDS = 5  # Rounds of reweighting, chosen by hand.
HUBER_SIGMAS = 2.0  # Scale of the Huber weights, in spreads, chosen by hand.


@dataclass(frozen=True)
class Signal:
    """N samples of D channels."""

    values: np.ndarray  # (N, D), finite, zero mean.
    rate_hz: float  # Samples per second.
    start_s: float = 0.0  # When the first sample was taken.


@dataclass(frozen=True)
class PairLag:
    """Lead of a second signal's clock over a first one's: ``lag + rate (t - middle)`` seconds."""

    lag_s: float  # At ``middle_s``.
    rate: float  # Seconds per second.
    covariance: np.ndarray  # (2, 2) of both.
    middle_s: float  # On the first one's clock.
    correlation: float  # Of the wholes at the lag, -1 to 1.


def pair_lag(first: Signal, second: Signal, *, reach_s: float, piece_s: float, floor_s: float) -> PairLag | None:
    """Return the lag of two signals of the same rate. None where they do not agree.

    Time t on the first clock is ``t + lag`` on the second. The wholes are correlated by FFT, normalised by the
    overlapping energies, then every piece near that lag, with its peak by a parabola. A robust line through the pieces,
    with the crystal's prior on its slope, gives lag and rate.

    Args:
        first: with (N, D) values.
        second: with (M, D) values.
        reach_s: largest lag looked for.
        piece_s: length of a piece.
        floor_s: least standard deviation, such as the delay of sound or a picture's interval.

    Reference: Knapp and Carter 1976 (delay by correlation); Huber 1964 (the robust line).
    """
    rate_hz = first.rate_hz
    shift = second.start_s - first.start_s
    whole = _correlation(first.values, second.values, shift, reach_s, rate_hz)
    if whole is None or whole[1] < LEAST_CORRELATION:
        return None
    coarse_s, correlation = whole
    size, near = max(round(piece_s * rate_hz), 8), 0.25 * piece_s
    starts = np.arange(0, max(len(first.values) - size, 0) + 1, max(size // 2, 1))
    rows = []
    for start in starts:
        at_s = first.start_s + start / rate_hz
        begin = round((at_s + coarse_s - second.start_s - near) * rate_hz)
        stop = begin + size + 2 * round(near * rate_hz)
        if begin < 0 or stop > len(second.values):
            continue
        piece = first.values[start : start + size]
        found = _correlation(piece, second.values[begin:stop], second.start_s + begin / rate_hz - at_s, None, rate_hz)
        if found is not None and found[1] >= LEAST_CORRELATION and abs(found[0] - coarse_s) < near:
            rows.append((at_s + 0.5 * size / rate_hz, found[0], found[1]))
    middle_s = first.start_s + 0.5 * len(first.values) / rate_hz
    if not rows:
        return PairLag(coarse_s, 0.0, np.diag([max(floor_s, 1 / rate_hz) ** 2, RATE_SIGMA**2]), middle_s, correlation)
    at_s, lag_s, agreement = np.array(rows).T
    (lag, rate), covariance = line_fit(at_s, lag_s, agreement, middle_s, floor_s)
    return PairLag(float(lag), float(rate), covariance, middle_s, correlation)


def line_fit(
    at_s: np.ndarray, lag_s: np.ndarray, weight: np.ndarray, middle_s: float, floor_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return lag at the middle and rate, (2,), and their (2, 2) covariance, of the robust line through pieces' lags.

    Args:
        at_s: (N,) seconds.
        lag_s: (N,) seconds.
        weight: (N,) correlations.
        middle_s: at which the lag is stated.
        floor_s: standard deviation common to all pieces.
    """
    basis = np.stack([np.ones_like(at_s), at_s - middle_s], axis=1)
    prior = np.diag([0.0, RATE_SIGMA**-2])
    step, spread = np.array([np.median(lag_s), 0.0]), 0.0
    information = np.eye(2)
    for _ in range(ROUNDS):
        residual = lag_s - basis @ step
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
        robust = weight**2 / np.maximum(1.0, np.abs(residual) / (HUBER_SIGMAS * spread))
        robust = robust / np.maximum(robust.max(), 1e-12) / spread**2
        # Pieces overlap by half: each shows half as much.
        information = 0.5 * (basis.T * robust) @ basis + prior
        step = np.linalg.solve(information, 0.5 * (basis.T * robust) @ lag_s)
    covariance = np.linalg.inv(information)
    covariance[0, 0] += floor_s**2
    return step, covariance


def _correlation(
    a: np.ndarray, b: np.ndarray, shift_s: float, reach_s: float | None, rate_hz: float
) -> tuple[float, float] | None:
    """Return the lag of b behind a in seconds and its normalised correlation. None where nothing overlaps enough."""
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    product = np.fft.irfft(np.fft.rfft(b, size, axis=0) * np.conj(np.fft.rfft(a, size, axis=0)), size, axis=0).sum(-1)
    lags = np.arange(-(len(a) - 1), len(b))
    energy_a, energy_b = (np.r_[0.0, np.cumsum((v**2).sum(-1))] for v in (a, b))
    low, high = np.maximum(0, -lags), np.minimum(len(a), len(b) - lags)
    overlap = high - low
    usable = overlap >= LEAST_OVERLAP * min(len(a), len(b))
    if reach_s is not None:
        usable &= np.abs(lags / rate_hz + shift_s) <= reach_s
    if not usable.any():
        return None
    lags, low, high = lags[usable], low[usable], high[usable]
    energy = (energy_a[high] - energy_a[low]) * (energy_b[high + lags] - energy_b[low + lags])
    score = product[lags % size] / np.sqrt(np.maximum(energy, 1e-30))
    # Long overlaps are surer than short ones that agree by chance.
    sure = score * np.sqrt((high - low) / (high - low).max())
    best = int(np.argmax(sure))
    fraction = _vertex(score[best - 1 : best + 2]) if 0 < best < len(score) - 1 else 0.0
    return float((lags[best] + fraction) / rate_hz + shift_s), float(score[best])


def _vertex(three: np.ndarray) -> float:
    """Return the vertex of the parabola through three values, in samples from the middle one."""
    bend = three[0] - 2 * three[1] + three[2]
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def convolved(values: np.ndarray, kernel: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return values convolved along an axis with an odd symmetric kernel; as many as before, zeros beyond the ends.

    Args:
        values: any shape, however short.
        kernel: (2 n + 1,).
    """
    reach = len(kernel) // 2

    def one(row: np.ndarray) -> np.ndarray:
        return np.convolve(row, kernel)[reach : reach + len(row)]

    return np.apply_along_axis(one, axis, np.asarray(values, dtype=np.float64))


def smoothed(values: np.ndarray, sigma: float) -> np.ndarray:
    """Return (N, ...) values after a Gaussian over the known ones, NaN where less than half of it is known.

    Args:
        values: NaN where unknown.
        sigma: standard deviation in samples.
    """
    reach = max(round(3 * sigma), 1)
    kernel, known = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2), np.isfinite(values)
    total, share = (convolved(a, kernel) for a in (np.where(known, values, 0.0), known.astype(float)))
    return np.where(share > 0.5 * kernel.sum(), total / np.maximum(share, 1e-9), np.nan)


class SyncUnknown(MocapError):
    """Nothing in the recording shows how the cameras' clocks differ."""
