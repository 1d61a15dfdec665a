"""What goes wrong with optical markers, and with a network that reads them: thesis 4.22-4.27 and 5.3.1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.synthesis.embedded.temporal_noise import autoregressive


@dataclass(frozen=True)
class DataNoise:
    """Corruption of F frames of n labelled points, drawn anew for every frame (thesis 4.22-4.27).

    The thesis tells the forms and not the numbers; these are chosen so that least squares errs about as much as in its
    table 5.1.
    """

    least_hidden: int = 0
    """m of 4.23."""
    most_hidden: int = 10
    """n' of 4.23."""
    ghosts: int = 2
    """n_ghost of 4.25."""
    reach_m: float = 0.3
    """A ghost takes the label of the nearest hidden point within this, as a labeller errs; others stay unlabelled."""
    displaced_share: float = 0.4
    """N of the measurement noise, as a share of the n points."""
    displacement_m: float = 0.1
    """M_noise of 4.26."""

    def __call__(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return (F, n, 3) points made worse, NaN where hidden."""
        hidden = self._chosen(points, rng.integers(self.least_hidden, self.most_hidden + 1, len(points)), rng)
        visible = np.where(hidden[..., None], np.nan, points)
        noisy = visible + self._displacements(points, rng)
        return self._with_ghosts(noisy, visible, points, hidden, rng)

    @staticmethod
    def _chosen(points: np.ndarray, count: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return (F, n) bool: so many points of each frame, without replacement (4.24)."""
        ranks = rng.random(points.shape[:2]).argsort(axis=1).argsort(axis=1)
        return ranks < count[:, None]

    def _displacements(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return offsets in a cube for a subset of the points (4.26, 4.27)."""
        count = np.full(len(points), round(self.displaced_share * points.shape[1]))
        moved = self._chosen(points, count, rng)
        return np.where(moved[..., None], rng.uniform(-self.displacement_m, self.displacement_m, points.shape), 0.0)

    def _with_ghosts(
        self, noisy: np.ndarray, visible: np.ndarray, truth: np.ndarray, hidden: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return the points with hidden ones replaced by ghosts near them (4.25)."""
        frames, centre = np.arange(len(truth)), np.nanmedian(visible, axis=1)
        off = np.nan_to_num(visible - np.nanmean(visible, axis=1, keepdims=True))
        covariance = np.swapaxes(off, 1, 2) @ off / ((~hidden).sum(1)[:, None, None] - 1)
        found = noisy.copy()
        for _ in range(self.ghosts):
            draw = rng.standard_normal((len(truth), 3, 1))
            ghost = centre + (np.linalg.cholesky(covariance) @ draw)[..., 0]
            distance = np.where(hidden, np.linalg.norm(truth - ghost[:, None], axis=-1), np.inf)
            nearest = distance.argmin(axis=1)
            near = distance[frames, nearest] <= self.reach_m
            found[frames[near], nearest[near]] = ghost[near]
        return found


@dataclass(frozen=True)
class InferenceNoise:
    """A network that infers landmarks from markers, simulated: it errs by landmark and by time, and fills what lacks.

    All numbers are chosen, none is measured.
    """

    sigma_m: float = 0.007
    """Standard deviation per axis at the trunk."""
    extremities: float = 2.5
    """Times as much at hands and feet (thesis 5.2.1)."""
    unevenness: float = 0.6
    """Standard deviation of the logarithm of each landmark's error, drifting."""
    memory_s: float = 0.2
    """Time in which errors fade: a network errs by pose, and poses last."""
    kept: float = 0.35
    """Share of the input's own error that comes through."""
    filled: float = 2.0
    """Times the error of a landmark whose marker was missing."""

    def __call__(
        self, points: np.ndarray, truth: np.ndarray, reach: np.ndarray, fps: float, rng: np.random.Generator
    ) -> np.ndarray:
        """Return (F, n, 3) inferred points, all of them there.

        Args:
            points: (F, n, 3) what the network saw, NaN where missing.
            truth: (F, n, 3) where the landmarks are.
            reach: (n,) 0 at the trunk to 1 at hands and feet.
            fps: frames per second.
            rng: seeded source of randomness.
        """
        memory = float(np.exp(-1.0 / (self.memory_s * fps)))
        drift = autoregressive((1, *points.shape), memory, rng)[0]
        uneven = np.exp(self.unevenness * autoregressive((1, *points.shape[:2]), memory, rng)[0])
        missing = ~np.isfinite(points).all(-1)
        sigma = self.sigma_m * (1.0 + (self.extremities - 1.0) * reach) * uneven * np.where(missing, self.filled, 1.0)
        through = np.where(missing[..., None], 0.0, self.kept * (points - truth))
        return truth + through + sigma[..., None] * drift
