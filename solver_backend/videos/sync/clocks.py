"""Estimate offsets and drifts of camera clocks, with covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.agreement.lags import Signal, signal_lags
from solver_backend.agreement.synchronisation import values_at
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, read_diagnostics
from solver_backend.exchange.errors import FileDamaged, MocapError
from solver_backend.exchange.plausible import LATEST_S
from solver_backend.io.files import read_json


def smoothed(values: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth (N, ...) values with a Gaussian of ``sigma`` samples. Values with mostly unknown neighbours are NaN."""
    reach = max(round(3 * sigma), 1)
    kernel, known = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2), np.isfinite(values)
    parts = np.where(known, values, 0.0), known.astype(float)
    total, share = (np.apply_along_axis(lambda row: np.convolve(row, kernel)[reach:-reach], 0, p) for p in parts)
    return np.where(share > 0.5 * kernel.sum(), total / np.maximum(share, 1e-9), np.nan)


class SyncUnknown(MocapError):
    """The recording does not show the offsets of the camera clocks."""


@dataclass(frozen=True)
class Clocks:
    """Clocks of C cameras. Time t of the first camera is ``t + offset_c + rate_c (t - t0)`` in the video of camera c.

    The clock of a video starts at its first image. The first camera is the reference, with offset and rate 0.
    """

    names: tuple[str, ...]  # Names of the cameras.
    offset_s: np.ndarray  # (C,) seconds at ``middle_s``.
    rate: np.ndarray  # (C,) seconds per second. 1e-6 is one part in a million.
    covariance: np.ndarray  # (C, 2, 2) covariance of offset and rate, NaN where unknown.
    middle_s: float  # t0, seconds.
    method: str = "as filmed"  # Name of the method for users.
    findings: tuple[Diagnostic, ...] = ()  # Warnings for the user.

    @classmethod
    def alike(cls, names: tuple[str, ...]) -> Clocks:
        """Return equal clocks, for cameras that a wire or software synchronised."""
        count = len(names)
        return cls(names, np.zeros(count), np.zeros(count), np.zeros((count, 2, 2)), 0.0)

    def in_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Convert times of the first camera's clock to the clock of another camera."""
        return times_s + self.offset_s[camera] + self.rate[camera] * (times_s - self.middle_s)

    def from_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Convert times of a camera's clock to the clock of the first camera."""
        late = times_s - self.offset_s[camera] - self.middle_s
        return self.middle_s + late / (1.0 + self.rate[camera])

    def notes(self) -> tuple[Diagnostic, ...]:
        """Return a note on each camera's clock except the first, or none if the videos are used as recorded."""
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
        """Return the clocks as plain values for a JSON file."""
        return {
            "cameras": list(self.names), "offset_s": self.offset_s.tolist(), "rate": self.rate.tolist(),
            "covariance": self.covariance.tolist(), "middle_s": self.middle_s, "method": self.method,
            "findings": [item.as_dict() for item in self.findings],
        }  # fmt: skip


def read_clocks(path: Path) -> Clocks:
    """Read the camera clocks in a JSON file.

    Raises:
        FileMissing, FileDamaged: the file does not exist, or contains no clocks.
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


def clocks_of_signals(names: tuple[str, ...], signals: Sequence[Signal], method: str, **limits: float) -> Clocks:
    """Estimate the camera clocks from one signal per camera, such as sound.

    Args:
        limits: keyword arguments of ``signal_lags``.

    Raises:
        SyncUnknown: the signal of a camera agrees with no other signal.
    """
    found = signal_lags(signals, **limits)
    if found.unknown:
        other = next(name for c, name in enumerate(names) if c not in found.unknown)
        raise SyncUnknown(
            f"{', '.join(names[c] for c in found.unknown)} cannot be synchronised with {other} by {method}.",
            where=", ".join(names),
            hint="Film again, and clap in view of all cameras and near their microphones.",
        )
    return Clocks(names, found.lag_s, found.rate, found.covariance, found.middle_s, method)


EXACT_SHARE = 0.01  # Largest distance of a time from an image that is used as it is, in image intervals.
LONGEST_GAP_S = 0.1  # Largest interval in seconds between two images that are interpolated.


def common_times(first_to_last: Sequence[tuple[float, float]], clocks: Clocks, fps: float) -> np.ndarray:
    """Return the (F,) frame times of a take that all videos cover.

    The first frame is an image of the video that starts last, so that synchronous cameras are not interpolated.

    Args:
        first_to_last: time of the first and the last image of each video on its own clock, seconds.
    """
    spans = [clocks.from_video(c, np.array(span)) for c, span in enumerate(first_to_last)]
    start, stop = max(span[0] for span in spans), min(span[1] for span in spans)
    return start + np.arange(max(int(np.floor((stop - start) * fps + EXACT_SHARE)) + 1, 0)) / fps


def at_times(values: np.ndarray, times_s: np.ndarray, wanted_s: np.ndarray) -> np.ndarray:
    """Interpolate values (F, ...) at ascending times to N other times. Return NaN next to a missing image."""
    if len(times_s) < 2:
        return np.full((len(wanted_s), *values.shape[1:]), np.nan)
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    gap = times_s[after] - times_s[after - 1]
    with np.errstate(divide="ignore", invalid="ignore"):  # two images with equal times: nothing is between them
        share = (wanted_s - times_s[after - 1]) / gap
    exact = (np.abs(share) <= EXACT_SHARE) | (np.abs(share - 1) <= EXACT_SHARE)
    share = np.where(exact, np.round(share), share)
    known = (share >= 0) & (share <= 1) & (exact | (gap <= LONGEST_GAP_S))
    return values_at(values, np.where(known, after - 1 + share, -1.0))
