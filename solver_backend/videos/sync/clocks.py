"""The clocks of cameras against each other: offset and drift, with what is known of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, read_diagnostics
from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.files import read_json

SIGMAS = 2.0
"""Standard deviations up to which a clock's difference is none: 95 %."""
LARGEST_SIGMA_S = 1e-3
"""A clock that is known less surely is not called in sync: at 60 frames a second a wrist at 3 m/s moves 3 mm in it."""


@dataclass(frozen=True)
class Clocks:
    """Where C cameras' clocks stand: what happens at t is in camera c's video at ``t + offset_c + rate_c (t - t0)``.

    Videos' clocks begin with their first picture. The first camera's clock is everybody's: its offset and rate are 0.
    """

    names: tuple[str, ...]
    """Names of the cameras."""
    offset_s: np.ndarray
    """(C,) seconds at ``middle_s``."""
    rate: np.ndarray
    """(C,) seconds a second; 1e-6 is one part in a million."""
    covariance: np.ndarray
    """(C, 2, 2) of offset and rate; NaN where unknown."""
    middle_s: float
    """t0, seconds."""
    method: str = "as filmed"
    """What they were estimated from."""
    findings: tuple[Diagnostic, ...] = ()
    """What the user should know."""

    @classmethod
    def alike(cls, names: tuple[str, ...]) -> Clocks:
        """Return clocks that agree: cameras that were started together by wire or software."""
        count = len(names)
        return cls(names, np.zeros(count), np.zeros(count), np.zeros((count, 2, 2)), 0.0)

    def in_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Return when, on a camera's clock, it is these times."""
        return times_s + self.offset_s[camera] + self.rate[camera] * (times_s - self.middle_s)

    def from_video(self, camera: int, times_s: np.ndarray) -> np.ndarray:
        """Return what time it is when a camera's clock shows these times; the inverse of ``in_video``."""
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
        """Return how each camera's clock stands; none where the cameras are taken as filmed."""
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
        """Return whether a clock is the first one's, or differs by no more than its uncertainty, which is small."""
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
