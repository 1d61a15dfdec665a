"""Offsets and drifts of camera clocks, with covariances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, read_diagnostics
from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.files import read_json
from solver_backend.videos.sync.signals import PairLag, SyncUnknown

SIGMAS = 2.0  # Standard deviations up to which a clock's difference is none: 95 %.
LARGEST_SIGMA_S = 1e-3
"""A clock with a larger deviation is not called in sync. A wrist at 3 m/s moves 3 mm in this time."""


@dataclass(frozen=True)
class Clocks:
    """Clocks of C cameras: time t is in camera c's video at ``t + offset_c + rate_c (t - t0)``.

    Videos' clocks begin with their first picture. The first camera's clock is everybody's: its offset and rate are 0.
    """

    names: tuple[str, ...]  # Names of the cameras.
    offset_s: np.ndarray  # (C,) seconds at ``middle_s``.
    rate: np.ndarray  # (C,) seconds per second; 1e-6 is one part in a million.
    covariance: np.ndarray  # (C, 2, 2) of offset and rate. NaN where unknown.
    middle_s: float  # t0, seconds.
    method: str = "as filmed"  # Method of the estimate.
    findings: tuple[Diagnostic, ...] = ()  # Warnings for the user.

    @classmethod
    def alike(cls, names: tuple[str, ...]) -> Clocks:
        """Return clocks that agree: cameras that were started together by wire or software."""
        count = len(names)
        return cls(names, np.zeros(count), np.zeros(count), np.zeros((count, 2, 2)), 0.0)

    def in_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Return these times on a camera's clock."""
        return times_s + self.offset_s[camera] + self.rate[camera] * (times_s - self.middle_s)

    def from_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Return the times of a camera's clock on the common clock, the inverse of ``in_video``."""
        late = times_s - self.offset_s[camera] - self.middle_s
        return self.middle_s + late / (1.0 + self.rate[camera])

    def sigma_s(self, times_s: np.ndarray) -> np.ndarray:
        """Return (C, N) standard deviations of the offset at these times, ``sqrt(jᵀ Σ j)`` with ``j = (1, t - t0)``."""
        j = np.stack([np.ones_like(times_s), times_s - self.middle_s])
        return np.sqrt(np.einsum("in,cij,jn->cn", j, self.covariance, j))

    def lines(self) -> list[str]:
        """Return a row for each camera."""
        rows = []
        for c, name in enumerate(self.names):
            offset_sigma, rate_sigma = np.sqrt(np.diag(self.covariance[c]))
            if self._in_sync(c):
                rows.append(f"{name}: in sync, by {self.method}")
                continue
            rows.append(
                f"{name}: {1e3 * self.offset_s[c]:+.2f} ms (± {1e3 * offset_sigma:.2f}), "
                f"{1e6 * self.rate[c]:+.1f} ppm (± {1e6 * rate_sigma:.1f}), by {self.method}"
            )
        return rows

    def notes(self) -> tuple[Diagnostic, ...]:
        """Return notes on each camera's clock, none if the cameras are used as filmed."""
        if self.method == "as filmed":
            return ()
        sigma = np.sqrt(self.covariance[:, (0, 1), (0, 1)])
        found = []
        for c, name in enumerate(self.names):
            figures: dict[str, Any] = {}
            if not self._in_sync(c):
                figures: dict[str, Any] = {"offset_ms": self.offset_s[c] * 1e3, "offset_sigma_ms": sigma[c, 0] * 1e3}
                figures |= {"rate_ppm": self.rate[c] * 1e6, "rate_sigma_ppm": sigma[c, 1] * 1e6}
            result = "offset" if figures else "sync"
            found.append(diagnostic("clock_estimated", result=result, cameras=[name], method=self.method, **figures))
        return tuple(found)

    def _in_sync(self, camera: int) -> bool:
        """Return whether a clock equals the first one within a small uncertainty."""
        found = np.array([self.offset_s[camera], self.rate[camera]])
        sigma = np.sqrt(np.diag(self.covariance[camera]))
        sure = sigma[0] <= LARGEST_SIGMA_S and (np.abs(found) <= SIGMAS * sigma).all()
        return not found.any() or bool(sure)

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a file."""
        return {
            "cameras": list(self.names), "offset_s": self.offset_s.tolist(), "rate": self.rate.tolist(),
            "covariance": self.covariance.tolist(), "middle_s": self.middle_s, "method": self.method,
            "findings": [item.as_dict() for item in self.findings],
        }  # fmt: skip


def read_clocks(path: Path) -> Clocks:
    """Read the clocks that ``as_dict`` has written.

    Raises:
        FileMissing, FileDamaged: there is no such file, or it holds no clocks.
    """
    values = read_json(path)
    try:
        names, findings = tuple(_texts(values["cameras"])), read_diagnostics(values["findings"])
        shapes = {"offset_s": (len(names),), "rate": (len(names),), "covariance": (len(names), 2, 2)}
        arrays = {key: np.array(values[key], dtype=np.float64).reshape(shape) for key, shape in shapes.items()}
        middle_s = float(values["middle_s"])
        if not np.isfinite([*arrays["offset_s"], *arrays["rate"], middle_s]).all():
            raise ValueError("an offset is not a number")
        return Clocks(names, **arrays, middle_s=middle_s, method=str(values["method"]), findings=findings)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileDamaged(
            f"The file holds no camera clocks ({error}).", where=str(path), hint="Remove it to synchronise again."
        ) from error


def _texts(values: Any) -> list[str]:
    if not isinstance(values, list) or not all(isinstance(item, str) for item in values):
        raise TypeError("names are lists of texts")
    return values


CONTRADICTION_S = 0.05  # Least deviation of a wrong pair's lag from the others.


def clocks_of_pairs(names: tuple[str, ...], pairs: Mapping[tuple[int, int], PairLag], method: str) -> Clocks:
    """Return the clocks that fit the lags of pairs (i, j) best.

    Pairs enter by their information. The pair that contradicts the rest most is excluded until none does. Every camera
    must be connected with the first.

    Raises:
        SyncUnknown: a camera is connected by no pair.
    """
    kept, findings = dict(pairs), list[Diagnostic]()
    middle_s = float(np.median([p.middle_s for p in pairs.values()])) if pairs else 0.0
    while True:
        _require_connected(names, kept, method)
        state, covariance = _solved(len(names), kept, middle_s)
        off = {(i, j): abs(_at(p, middle_s) - (state[j, 0] - state[i, 0])) for (i, j), p in kept.items()}
        worst = max(off, key=lambda pair: off[pair])
        without = {pair: p for pair, p in kept.items() if pair != worst}
        if off[worst] < CONTRADICTION_S or not _connected(len(names), without):
            break
        findings.append(diagnostic("clocks_disagree", cameras=[names[c] for c in worst], method=method))
        kept = without
    if off[worst] >= CONTRADICTION_S:
        findings.append(diagnostic("clocks_contradict", method=method, off_ms=1e3 * off[worst]))
    return Clocks(names, state[:, 0], state[:, 1], covariance, middle_s, method, tuple(findings))


def _at(pair: PairLag, middle_s: float) -> float:
    return pair.lag_s + pair.rate * (middle_s - pair.middle_s)


def _solved(count: int, pairs: Mapping[tuple[int, int], PairLag], middle_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return offsets and rates (C, 2) and covariances (C, 2, 2), the first camera's zero."""
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


def _connected(count: int, pairs: Mapping[tuple[int, int], PairLag]) -> set[int]:
    """Return all cameras if they are connected, else nothing."""
    reached = {0}
    for _ in range(count):
        reached |= {b for pair in pairs for a, b in (pair, pair[::-1]) if a in reached}
    return reached if len(reached) == count else set()


def _require_connected(names: tuple[str, ...], pairs: Mapping[tuple[int, int], PairLag], method: str) -> None:
    if _connected(len(names), pairs):
        return
    joined = {c for pair in pairs for c in pair}
    alone = [names[c] for c in range(len(names)) if c not in joined] or list(names)
    raise SyncUnknown(
        f"By {method} the cameras cannot be synchronised: nothing in {', '.join(alone)} agrees with another.",
        where=", ".join(names),
        hint="Clap in sight of all cameras and film again, or try another method of --sync.",
    )


EXACT_SHARE = 0.01  # A moment this near a picture, as a share of the interval, is that picture.
LONGEST_GAP_S = 0.1  # Largest interval of pictures that are interpolated.


def common_times(first_to_last: Sequence[tuple[float, float]], clocks: Clocks, fps: float) -> np.ndarray:
    """Return (F,) moments of all videos, 1/fps apart. Empty without any.

    They begin with a picture of the video that starts last, so that detections of cameras in step do not change.

    Args:
        first_to_last: each video's first and last time on its own clock, which begins with its first picture.
        clocks: of the cameras, in the same order.
        fps: moments per second.
    """
    spans = [clocks.from_video(c, np.array(span)) for c, span in enumerate(first_to_last)]
    start, stop = max(span[0] for span in spans), min(span[1] for span in spans)
    return start + np.arange(max(int(np.floor((stop - start) * fps + EXACT_SHARE)) + 1, 0)) / fps


def at_times(values: np.ndarray, times_s: np.ndarray, wanted_s: np.ndarray) -> np.ndarray:
    """Return (N, ...) values at moments, linear between neighbouring pictures. NaN where one is missing.

    Args:
        values: (F, ...), NaN where missing.
        times_s: (F,) ascending, uneven if the rate is.
        wanted_s: (N,); beyond the first and last picture is NaN.
    """
    if len(times_s) < 2:
        return np.full((len(wanted_s), *values.shape[1:]), np.nan)
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    gap = times_s[after] - times_s[after - 1]
    with np.errstate(divide="ignore", invalid="ignore"):  # two pictures of one time: neither lies between them
        share = (wanted_s - times_s[after - 1]) / gap
    outside = (share < -EXACT_SHARE) | (share > 1 + EXACT_SHARE)
    exact = (np.abs(share) <= EXACT_SHARE) | (np.abs(share - 1) <= EXACT_SHARE)
    share = np.where(exact, np.round(share), share)
    unknown = outside | ((gap > LONGEST_GAP_S) & ~exact)
    share, unknown = (a.reshape(-1, *[1] * (values.ndim - 1)) for a in (share, unknown))
    low, high = np.where(share < 1, values[after - 1], 0.0), np.where(share > 0, values[after], 0.0)
    return np.where(unknown, np.nan, (1 - share) * low + share * high)
