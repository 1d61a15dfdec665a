"""Measure realism and variety of generated poses: FID and DIV (thesis eqs. 4.30, 4.31, 6.11, 6.12)."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.errors import ShapeMismatch
from solver_backend.types.shapes import Float

Features = Float[np.ndarray, "samples features"]


def frechet_distance(generated: Features, real: Float[np.ndarray, "others features"]) -> float:
    """Return FID: ``|μ_a - μ_b|² + Tr(Σ_a + Σ_b - 2 (Σ_a Σ_b)^½)``, in the features' squared unit.

    Both are (N, D) features of two or more samples. The trace of the root is that of the symmetric
    ``(Σ_a^½ Σ_b Σ_a^½)^½``.

    Raises:
        ShapeMismatch: other arrays, or NaN.
    Reference: Heusel et al. 2017, "GANs trained by a two time-scale update rule", eq. 6; thesis eqs. 4.30, 6.11.
    """
    generated, real = _features(generated), _features(real)
    if generated.shape[1] != real.shape[1]:
        lengths = f"{generated.shape[1]} and {real.shape[1]}"
        raise ShapeMismatch(f"Features of lengths {lengths} cannot be compared.", where="metrics")
    cov_a, cov_b = (np.atleast_2d(np.cov(f, rowvar=False)) for f in (generated, real))
    values, vectors = np.linalg.eigh(cov_a)
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    shared = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ cov_b @ root), 0.0)).sum()
    apart = ((generated.mean(axis=0) - real.mean(axis=0)) ** 2).sum()
    return float(apart + np.trace(cov_a) + np.trace(cov_b) - 2.0 * shared)


def diversity(features: Features, seed: int) -> float:
    """Return DIV: the mean distance between the pairs of two random halves of (N, D) features, in their unit.

    The thesis pairs 526 of 1,052 generated poses with the other 526; an odd sample is left out.

    Raises:
        ShapeMismatch: another array, or NaN.

    Reference: thesis eqs. 4.31, 6.12.
    """
    features = _features(features)
    order, half = np.random.default_rng(seed).permutation(len(features)), len(features) // 2
    return float(np.linalg.norm(features[order[:half]] - features[order[half : 2 * half]], axis=1).mean())


def _features(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 2 or len(values) < 2 or not np.isfinite(values).all():
        hint = "(samples, features) are expected: two samples or more, and no NaN."
        raise ShapeMismatch(f"Features of shape {values.shape} cannot be compared.", where="metrics", hint=hint)
    return values


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """Return Spearman's ρ, the correlation of the ranks of two (N,) lists without ties (Spearman 1904)."""
    ranks = [np.argsort(np.argsort(values)) for values in (a, b)]
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])
