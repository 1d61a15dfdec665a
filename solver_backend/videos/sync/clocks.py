"""Estimate offsets and drifts of camera clocks, with covariances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from solver_backend.agreement.evidence import MOST_ROUNDS, SIGMAS
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, read_diagnostics
from solver_backend.exchange.errors import FileDamaged, MocapError
from solver_backend.exchange.plausible import LATEST_S
from solver_backend.io.files import read_json

LEAST_CORRELATION = 0.25  # Smallest correlation of pieces and whole signals.
LEAST_OVERLAP = 0.3  # Smallest overlap at a lag, relative to the shorter signal.
RATE_SIGMA = 25e-6  # Prior standard deviation of a camera's rate. Quartz clocks stay within 50 ppm.


@dataclass(frozen=True)
class Signal:
    """A signal with N samples of D channels."""

    values: np.ndarray  # (N, D) finite values with zero mean.
    rate_hz: float  # Samples per second.
    start_s: float = 0.0  # Time of the first sample.


@dataclass(frozen=True)
class PairLag:
    """Lead of the second signal's clock over the first one's: ``lag + rate (t - middle)`` seconds."""

    lag_s: float  # Lag at ``middle_s``.
    rate: float  # Seconds per second.
    covariance: np.ndarray  # (2, 2) covariance of lag and rate.
    middle_s: float  # Time on the first clock.
    correlation: float  # Correlation of the whole signals at the lag, -1 to 1.


def pair_lag(first: Signal, second: Signal, *, reach_s: float, piece_s: float, floor_s: float) -> PairLag | None:
    """Return the lag of two signals with the same sample rate. None if they do not agree.

    Time t on the first clock is ``t + lag`` on the second. The whole signals are correlated by FFT and normalised by
    the overlapping energies. Then every piece is correlated near that lag, with parabolic peak interpolation. A robust
    line through the pieces, with the quartz prior on its slope, gives lag and rate.

    Args:
        first: signal with (N, D) values.
        second: signal with (M, D) values.
        floor_s: smallest standard deviation in seconds, such as the delay of sound or an image interval.

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
    """Fit a robust line through lags: lag at the middle and rate (2,), covariance (2, 2).

    Pieces have (N,) correlations as weights, and ``floor_s`` is their common standard deviation.
    """
    basis = np.stack([np.ones_like(at_s), at_s - middle_s], axis=1)
    prior = np.diag([0.0, RATE_SIGMA**-2])
    step, spread = np.array([np.median(lag_s), 0.0]), 0.0
    information = np.eye(2)
    for _ in range(MOST_ROUNDS):
        residual = lag_s - basis @ step
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
        robust = weight**2 / np.maximum(1.0, np.abs(residual) / (SIGMAS * spread))
        robust = robust / np.maximum(robust.max(), 1e-12) / spread**2
        # Pieces overlap by half, so each has half of the information.
        information = 0.5 * (basis.T * robust) @ basis + prior
        step = np.linalg.solve(information, 0.5 * (basis.T * robust) @ lag_s)
    covariance = np.linalg.inv(information)
    covariance[0, 0] += floor_s**2
    return step, covariance


def _correlation(
    a: np.ndarray, b: np.ndarray, shift_s: float, reach_s: float | None, rate_hz: float
) -> tuple[float, float] | None:
    """Return the lag of b behind a in seconds and its correlation, None if too short."""
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
    # Long overlaps are more reliable than short ones that agree by chance.
    sure = score * np.sqrt((high - low) / (high - low).max())
    best = int(np.argmax(sure))
    fraction = _vertex(score[best - 1 : best + 2]) if 0 < best < len(score) - 1 else 0.0
    return float((lags[best] + fraction) / rate_hz + shift_s), float(score[best])


def _vertex(three: np.ndarray) -> float:
    """Return the vertex of the parabola through three values, in samples from the middle one."""
    bend = three[0] - 2 * three[1] + three[2]
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def convolved(values: np.ndarray, kernel: np.ndarray, axis: int = 0) -> np.ndarray:
    """Convolve values along an axis with an odd symmetric kernel and zero padding."""
    reach = len(kernel) // 2

    def one(row: np.ndarray) -> np.ndarray:
        return np.convolve(row, kernel)[reach : reach + len(row)]

    return np.apply_along_axis(one, axis, np.asarray(values, dtype=np.float64))


def smoothed(values: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth (N, ...) values with a Gaussian of ``sigma`` samples, NaN where less than half is known."""
    reach = max(round(3 * sigma), 1)
    kernel, known = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2), np.isfinite(values)
    total, share = (convolved(a, kernel) for a in (np.where(known, values, 0.0), known.astype(float)))
    return np.where(share > 0.5 * kernel.sum(), total / np.maximum(share, 1e-9), np.nan)


class SyncUnknown(MocapError):
    """The recording does not show how the clocks of the cameras differ."""


@dataclass(frozen=True)
class Clocks:
    """Clocks of C cameras. Time t is ``t + offset_c + rate_c (t - t0)`` in camera c's video.

    Each video's clock starts at its first image. The reference is the first camera's clock, with offset and rate 0.
    """

    names: tuple[str, ...]  # Names of the cameras.
    offset_s: np.ndarray  # (C,) seconds at ``middle_s``.
    rate: np.ndarray  # (C,) seconds per second. 1e-6 is one part in a million.
    covariance: np.ndarray  # (C, 2, 2) covariance of offset and rate, NaN where unknown.
    middle_s: float  # t0, seconds.
    method: str = "as filmed"  # Method of the estimate.
    findings: tuple[Diagnostic, ...] = ()  # Warnings for the user.

    @classmethod
    def alike(cls, names: tuple[str, ...]) -> Clocks:
        """Return equal clocks, for cameras that were started together by wire or software."""
        count = len(names)
        return cls(names, np.zeros(count), np.zeros(count), np.zeros((count, 2, 2)), 0.0)

    def in_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Convert times to a camera's clock."""
        return times_s + self.offset_s[camera] + self.rate[camera] * (times_s - self.middle_s)

    def from_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Convert times of a camera's clock to the common clock, the inverse of ``in_video``."""
        late = times_s - self.offset_s[camera] - self.middle_s
        return self.middle_s + late / (1.0 + self.rate[camera])

    def notes(self) -> tuple[Diagnostic, ...]:
        """Return notes on the other cameras' clocks, none if the cameras are used as recorded."""
        if self.method == "as filmed":
            return ()
        sigma = np.sqrt(self.covariance[:, (0, 1), (0, 1)])
        return tuple(
            diagnostic(
                "clock_estimated", cameras=[name], method=self.method, offset_ms=self.offset_s[c] * 1e3,
                offset_sigma_ms=sigma[c, 0] * 1e3, rate_ppm=self.rate[c] * 1e6, rate_sigma_ppm=sigma[c, 1] * 1e6,
            )
            for c, name in enumerate(self.names)
            if c
        )  # fmt: skip

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a file."""
        return {
            "cameras": list(self.names), "offset_s": self.offset_s.tolist(), "rate": self.rate.tolist(),
            "covariance": self.covariance.tolist(), "middle_s": self.middle_s, "method": self.method,
            "findings": [item.as_dict() for item in self.findings],
        }  # fmt: skip


def read_clocks(path: Path) -> Clocks:
    """Read clocks that ``as_dict`` wrote.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it has no clocks.
    """
    values = read_json(path)
    try:
        names, findings = tuple(values["cameras"]), read_diagnostics(values["findings"])
        if not isinstance(values["cameras"], list) or not all(isinstance(name, str) for name in names):
            raise TypeError("names are lists of texts")
        shapes = {"offset_s": (len(names),), "rate": (len(names),), "covariance": (len(names), 2, 2)}
        arrays = {key: np.array(values[key], dtype=np.float64).reshape(shape) for key, shape in shapes.items()}
        middle_s = float(values["middle_s"])
        if not (np.abs([*arrays["offset_s"], *arrays["rate"], middle_s]) <= LATEST_S).all():
            raise ValueError("an offset is too large")
        if (arrays["covariance"][:, (0, 1), (0, 1)] < 0.0).any():
            raise ValueError("a variance is negative")
        return Clocks(names, **arrays, middle_s=middle_s, method=str(values["method"]), findings=findings)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileDamaged(
            f"The file contains no camera clocks ({error}).", where=str(path), hint="Remove it to synchronise again."
        ) from error


CONTRADICTION_S = 0.05  # Smallest deviation of a wrong pair's lag from the others, seconds.


def clocks_of_pairs(names: tuple[str, ...], pairs: Mapping[tuple[int, int], PairLag], method: str) -> Clocks:
    """Return the clocks that best fit the lags of pairs (i, j).

    Pairs are weighted by their information. The most contradictory pair is excluded until none contradicts the others.
    Pairs must connect all cameras.

    Raises:
        SyncUnknown: no pair connects a camera.
    """
    kept, findings = dict(pairs), list[Diagnostic]()
    middle_s = float(np.median([p.middle_s for p in pairs.values()])) if pairs else 0.0
    if alone := _unconnected(len(names), kept):
        other = next(name for c, name in enumerate(names) if c not in alone)
        raise SyncUnknown(
            f"{', '.join(names[c] for c in alone)} cannot be synchronised with {other} by {method}.",
            where=", ".join(names),
            hint="Film again, and clap in view of all cameras and near their microphones.",
        )
    while True:
        state, covariance = _solved(len(names), kept, middle_s)
        off = {(i, j): abs(_at(p, middle_s) - (state[j, 0] - state[i, 0])) for (i, j), p in kept.items()}
        worst = max(off, key=lambda pair: off[pair])
        if off[worst] < CONTRADICTION_S:
            break
        without = {pair: p for pair, p in kept.items() if pair != worst}
        usage = "used" if _unconnected(len(names), without) else "unused"
        values = {"method": method, "off_ms": 1e3 * off[worst], "usage": usage}
        findings.append(diagnostic("clocks_disagree", cameras=[names[c] for c in worst], **values))
        if usage == "used":
            break
        kept = without
    return Clocks(names, state[:, 0], state[:, 1], covariance, middle_s, method, tuple(findings))


def clocks_of_signals(
    names: tuple[str, ...], signals: Sequence[Signal], method: str, *, reach_s: float, piece_s: float, floor_s: float,
    least: float = 0.0,
) -> Clocks:  # fmt: skip
    """Estimate camera clocks from signals with the same sample rate (see ``pair_lag``).

    Correlations must exceed ``least``.

    Raises:
        SyncUnknown: a camera agrees with no other camera.
    """
    pairs = dict[tuple[int, int], PairLag]()
    for i, j in combinations(range(len(names)), 2):
        found = pair_lag(signals[i], signals[j], reach_s=reach_s, piece_s=piece_s, floor_s=floor_s)
        if found is not None and found.correlation > least:
            pairs[i, j] = found
    return clocks_of_pairs(names, pairs, method)


def _at(pair: PairLag, middle_s: float) -> float:
    return pair.lag_s + pair.rate * (middle_s - pair.middle_s)


def _solved(count: int, pairs: Mapping[tuple[int, int], PairLag], middle_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets and rates (C, 2) and covariances (C, 2, 2). They are zero for the first camera."""
    normal, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    for (i, j), pair in pairs.items():
        moved = np.array([[1.0, middle_s - pair.middle_s], [0.0, 1.0]])
        information = np.linalg.inv(moved @ pair.covariance @ moved.T)
        rows = np.zeros((2, 2 * count))
        rows[:, 2 * i : 2 * i + 2], rows[:, 2 * j : 2 * j + 2] = -np.eye(2), np.eye(2)
        normal += rows.T @ information @ rows
        right += rows.T @ information @ np.array([_at(pair, middle_s), pair.rate])
    state, covariance = np.zeros((count, 2)), np.zeros((count, 2, 2))
    inverse = np.linalg.inv(normal[2:, 2:])
    state[1:] = (inverse @ right[2:]).reshape(-1, 2)
    for c in range(1, count):
        covariance[c] = inverse[2 * c - 2 : 2 * c, 2 * c - 2 : 2 * c]
    return state, covariance


def _unconnected(count: int, pairs: Mapping[tuple[int, int], PairLag]) -> list[int]:
    """Return the cameras outside the largest group that chains of pairs connect."""
    groups = [{c} for c in range(count)]
    for a, b in pairs:
        joined = groups[a] | groups[b]
        groups = [joined if c in joined else group for c, group in enumerate(groups)]
    return sorted({*range(count)} - max(groups, key=len))


EXACT_SHARE = 0.01  # A time this close to an image, relative to the interval, uses that image.
LONGEST_GAP_S = 0.1  # Largest interval between images that are interpolated.


def common_times(first_to_last: Sequence[tuple[float, float]], clocks: Clocks, fps: float) -> np.ndarray:
    """Return the (F,) times that all videos cover, 1/fps apart, from their first and last times.

    They begin with an image of the video that starts last, so that detections of synchronous cameras do not change.
    """
    spans = [clocks.from_video(c, np.array(span)) for c, span in enumerate(first_to_last)]
    start, stop = max(span[0] for span in spans), min(span[1] for span in spans)
    return start + np.arange(max(int(np.floor((stop - start) * fps + EXACT_SHARE)) + 1, 0)) / fps


def at_times(values: np.ndarray, times_s: np.ndarray, wanted_s: np.ndarray) -> np.ndarray:
    """Interpolate values (F, ...) at ascending times to (N, ...) times, NaN next to a missing image."""
    if len(times_s) < 2:
        return np.full((len(wanted_s), *values.shape[1:]), np.nan)
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    gap = times_s[after] - times_s[after - 1]
    with np.errstate(divide="ignore", invalid="ignore"):  # two images with equal times: nothing is between them
        share = (wanted_s - times_s[after - 1]) / gap
    outside = (share < -EXACT_SHARE) | (share > 1 + EXACT_SHARE)
    exact = (np.abs(share) <= EXACT_SHARE) | (np.abs(share - 1) <= EXACT_SHARE)
    share = np.where(exact, np.round(share), share)
    unknown = outside | ((gap > LONGEST_GAP_S) & ~exact)
    share, unknown = (a.reshape(-1, *[1] * (values.ndim - 1)) for a in (share, unknown))
    low, high = np.where(share < 1, values[after - 1], 0.0), np.where(share > 0, values[after], 0.0)
    return np.where(unknown, np.nan, (1 - share) * low + share * high)
