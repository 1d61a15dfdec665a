"""Curves of cubic pieces through a few keys, with the slopes that fit whole curves best."""

from __future__ import annotations

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

    @classmethod
    def fitted(cls, values: np.ndarray, frames: np.ndarray) -> SparseCurves:
        """Return the curves through some frames (K,) of whole curves (F, N) that are nearest to them in between."""
        if len(values) == 1:
            return cls(np.zeros(1, int), values, np.zeros_like(values))
        return cls(frames, values[frames], fit_slopes(values, frames))

    def sampled(self, num_frames: int) -> np.ndarray:
        """Return the (F, N) values on every frame of the take."""
        if len(self.frames) == 1:
            return np.repeat(self.values, num_frames, axis=0)
        left, basis = _hermite(self.frames, num_frames)
        at_left, at_right, slope_left, slope_right = basis.T[..., None]
        ends = at_left * self.values[left] + at_right * self.values[left + 1]
        return ends + slope_left * self.slopes[left] + slope_right * self.slopes[left + 1]


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


def _hermite(frames: np.ndarray, num_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the key before each frame (F,) and the weights (F, 4) of both values and both slopes around it."""
    at = np.arange(num_frames)
    left = np.clip(np.searchsorted(frames, at, "right") - 1, 0, len(frames) - 2)
    length = (frames[left + 1] - frames[left]).astype(float)
    u = (at - frames[left]) / length
    value_right = u * u * (3 - 2 * u)
    slopes = length * u * (1 - u) * (1 - u), -length * u * u * (1 - u)
    return left, np.stack([1 - value_right, value_right, *slopes], axis=1)
