"""Simulate the noise of optical markers (thesis 4.22 to 4.27 and 5.3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DataNoise:
    """Corrupts n labelled points separately in each of F frames (thesis 4.22-4.27).

    The thesis gives distributions without numbers. With our numbers, least squares has about the same error as in table
    5.1 of the thesis.
    """

    least_hidden: int = 0  # m in 4.23.
    most_hidden: int = 10  # n' in 4.23.
    ghosts: int = 2  # n_ghost in 4.25.
    reach_m: float = 0.3
    """Largest distance in metres from a ghost to the hidden point that gives its label. Other ghosts have no label."""
    displaced_share: float = 0.4  # N in the measurement noise, as a fraction of the n points.
    displacement_m: float = 0.1  # M_noise in 4.26.

    def __call__(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Corrupt points (F, n, 3), NaN where hidden. A ghost near a hidden point replaces that point."""
        noisy, ghosts, hidden = self._spoiled(points, rng)
        frames = np.arange(len(points))
        for ghost in np.swapaxes(ghosts, 0, 1):
            distance = np.where(hidden, np.linalg.norm(points - ghost[:, None], axis=-1), np.inf)
            nearest = distance.argmin(axis=1)
            near = distance[frames, nearest] <= self.reach_m
            noisy[frames[near], nearest[near]] = ghost[near]
        return noisy

    def cloud(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Corrupt points, and add the ghosts as unlabelled points: (F, n + ghosts, 3)."""
        noisy, ghosts, _ = self._spoiled(points, rng)
        return np.concatenate([noisy, ghosts], axis=1)

    def _spoiled(self, points: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return corrupted points (F, n, 3), ghosts (F, ghosts, 3), and a mask (F, n) of hidden points."""
        hidden = self._chosen(points, rng.integers(self.least_hidden, self.most_hidden + 1, len(points)), rng)
        visible = np.where(hidden[..., None], np.nan, points)
        noisy = visible + self._displacements(points, rng)
        return noisy, self._ghosts(visible, hidden, rng), hidden

    @staticmethod
    def _chosen(points: np.ndarray, count: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draw a mask (F, n) of ``count`` points in each frame without replacement (4.24)."""
        ranks = rng.random(points.shape[:2]).argsort(axis=1).argsort(axis=1)
        return ranks < count[:, None]

    def _displacements(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draw offsets (F, n, 3) from a cube for a subset of the points (4.26, 4.27)."""
        count = np.full(len(points), round(self.displaced_share * points.shape[1]))
        moved = self._chosen(points, count, rng)
        return np.where(moved[..., None], rng.uniform(-self.displacement_m, self.displacement_m, points.shape), 0.0)

    def _ghosts(self, visible: np.ndarray, hidden: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Draw ghosts (F, ghosts, 3) with the median and covariance of the visible points (4.25)."""
        centre = np.nanmedian(visible, axis=1)
        off = np.nan_to_num(visible - np.nanmean(visible, axis=1, keepdims=True))
        covariance = np.swapaxes(off, 1, 2) @ off / ((~hidden).sum(1)[:, None, None] - 1)
        root = np.linalg.cholesky(covariance)
        draws = [(root @ rng.standard_normal((len(visible), 3, 1)))[..., 0] for _ in range(self.ghosts)]
        return centre[:, None] + np.stack(draws, axis=1) if draws else np.zeros((len(visible), 0, 3))
