"""Estimate the noise and the outlier rate of distances, from counts per bin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BINS = 98
LEAST_NOISE = 0.002
"""Of the person's size in the picture: smaller is rounding and joint definitions."""
OUTLIER_DENSITY = 0.5  # Density of outliers: uniform over twice the person's size.
_SMALLEST, _LARGEST = 1e-3, 3.0
_STEP = np.log(_LARGEST / _SMALLEST) / (BINS - 2)
_EDGES = np.geomspace(_SMALLEST, _LARGEST, BINS - 1)
_CENTRES = np.concatenate([[_SMALLEST / 2], np.sqrt(_EDGES[1:] * _EDGES[:-1]), [_LARGEST * 1.3]])
_ROUNDS = 12
_STARTS = (0.5, 1.5), (0.2, 3.0)
"""Quantiles of the distances at which EM begins, and factors from them to a standard deviation."""


@dataclass(frozen=True)
class Noise:
    """Normal errors with uniform outliers, fitted to N sets of distances."""

    density: np.ndarray  # (N,) mean log density of a distance, nats.
    sigma: np.ndarray  # (N,) standard deviation.
    outliers: np.ndarray  # (N,) outlier rate.

    def log_density(self, distance: np.ndarray) -> np.ndarray:
        """Return the log density of distances, for a single set."""
        return log_density(distance, float(self.sigma[0]), float(self.outliers[0]))


def log_density(distance: np.ndarray, sigma: float, outliers: float) -> np.ndarray:
    """Return the log density of distances under normal errors with uniform outliers."""
    inner = (1 - outliers) / (sigma * np.sqrt(2 * np.pi)) * np.exp(-0.5 * np.minimum((distance / sigma) ** 2, 1e3))
    return np.log(inner + outliers * OUTLIER_DENSITY)


def density_per_bin(sigma: float, outliers: float) -> np.ndarray:
    """Return (BINS,) the log density of distances in each bin."""
    return log_density(_CENTRES, sigma, outliers)


def expected_density(sigma: float, outliers: float, outlier_density: float = OUTLIER_DENSITY) -> float:
    """Return the mean log density of distances that follow this noise."""
    inner = (1 - outliers) * (np.log(1 - outliers) - np.log(sigma * np.sqrt(2 * np.pi)) - 0.5)
    return float(inner + outliers * np.log(outliers * outlier_density))


def count_in_bins(distance: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return (N, BINS) weights per bin of N sets of distances (N, ...); NaN is not counted."""
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.log(np.abs(distance) / _SMALLEST) / _STEP + 1
    known = np.isfinite(distance)
    bins = np.clip(np.where(known, np.nan_to_num(place, neginf=0.0), 0.0), 0, BINS - 1).astype(int)
    count = len(distance)
    rows = bins + BINS * np.arange(count).reshape(-1, *[1] * (distance.ndim - 1))
    weights = np.where(known, np.broadcast_to(weight, distance.shape), 0.0)
    return np.bincount(rows.ravel(), weights.ravel(), BINS * count).reshape(count, BINS)


def fit_noise(counts: np.ndarray, least: float = LEAST_NOISE, outlier_density: float = OUTLIER_DENSITY) -> Noise:
    """Return the noise of N sets of distances, by expectation maximisation from two starts.

    Args:
        counts: (N, BINS), see ``count_in_bins``.
        least: smallest standard deviation.
        outlier_density: of the uniform outliers.

    Reference: Dempster, Laird and Rubin 1977.
    """
    total = np.maximum(counts.sum(1), 1e-9)
    cumulated = np.cumsum(counts, axis=1) / total[:, None]
    best: Noise | None = None
    for quantile, factor in _STARTS:
        sigma = np.maximum(_CENTRES[np.minimum((cumulated < quantile).sum(1), BINS - 1)] * factor, least)
        outliers = np.full(len(counts), 0.2)
        for _ in range(_ROUNDS):
            inner = _normal(sigma, outliers)
            inliers = counts * inner / (inner + outliers[:, None] * outlier_density)
            share = inliers.sum(1)
            sigma = np.maximum(np.sqrt(inliers @ _CENTRES**2 / np.maximum(share, 1e-9)), least)
            outliers = np.clip(1 - share / total, 0.005, 0.95)
        density = (counts * np.log(_normal(sigma, outliers) + outliers[:, None] * outlier_density)).sum(1) / total
        if best is None:
            best = Noise(density, sigma, outliers)
        else:
            better = density > best.density
            pairs = ((density, best.density), (sigma, best.sigma), (outliers, best.outliers))
            best = Noise(*(np.where(better, new, old) for new, old in pairs))
    assert best is not None
    return best


def _normal(sigma: np.ndarray, outliers: np.ndarray) -> np.ndarray:
    square = (_CENTRES / sigma[:, None]) ** 2
    return (1 - outliers[:, None]) / (sigma[:, None] * np.sqrt(2 * np.pi)) * np.exp(-0.5 * np.minimum(square, 1e3))
