"""Train the Gaussian mixture, from the corpus to the weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from research.priors import load_gmm
from solver_backend.body.rest_skeleton import BODY_MIRROR
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.rotations import log_so3
from training.data.corpus import Corpus
from training.engine.publish import Card, Finished, TrainingJob, publish


@dataclass(frozen=True)
class Mixture:
    """Mixture of K Gaussians in d dimensions."""

    weights: np.ndarray  # (K,) component weights.
    means: np.ndarray  # (K, d) means.
    factors: np.ndarray  # (K, d, d) lower Cholesky factors of the covariance matrices.

    def log_densities(self, x: np.ndarray) -> np.ndarray:
        """Return the weighted log density (N, K) of each Gaussian at points (N, d)."""
        columns = []
        for weight, mean, factor in zip(self.weights, self.means, self.factors, strict=True):
            scaled = np.linalg.solve(factor, (x - mean).T)
            log_norm = np.log(np.diagonal(factor)).sum() + 0.5 * len(mean) * np.log(2 * np.pi)
            columns.append(np.log(weight) - log_norm - 0.5 * (scaled * scaled).sum(axis=0))
        return np.stack(columns, axis=1)


def fit_mixture(
    x: np.ndarray, components: int, seed: int, *, ridge: float = 1e-3, iterations: int = 60, progress: Progress = silent
) -> tuple[Mixture, list[float]]:
    """Fit a mixture of Gaussians to points (N, d).

    Args:
        x: (N, d) points.
        components: number K of Gaussians.
        seed: seed of the initial means (k-means++).
        ridge: value added to the diagonal of each covariance.
        iterations: largest number of iterations. Fitting stops once the mean log likelihood gains less than 1e-4.
        progress: called at every iteration.

    Returns:
        The mixture, and the mean log likelihood at every iteration. Only the ridge can make it decrease.

    Reference: Dempster, Laird & Rubin 1977, and Arthur & Vassilvitskii 2007 for the initial means.
    """
    shares = np.eye(components)[_nearest_seed(x, components, np.random.default_rng(seed))]
    history: list[float] = []
    mixture = _maximised(x, shares, ridge)
    for iteration in range(iterations):
        log_densities = mixture.log_densities(x)
        top = log_densities.max(axis=1, keepdims=True)
        total = top + np.log(np.exp(log_densities - top).sum(axis=1, keepdims=True))
        shares = np.exp(log_densities - total)
        history.append(float(total.mean()))
        progress("Fitting the mixture", iteration + 1, iterations)
        if len(history) > 1 and abs(history[-1] - history[-2]) < 1e-4:
            break
        mixture = _maximised(x, shares, ridge)
    return mixture, history


def _maximised(x: np.ndarray, shares: np.ndarray, ridge: float) -> Mixture:
    counts = shares.sum(axis=0) + 1e-9
    means = (shares.T @ x) / counts[:, None]
    factors = []
    for k in range(shares.shape[1]):
        centred = x - means[k]
        covariance = (centred * shares[:, k : k + 1]).T @ centred / counts[k]
        factors.append(np.linalg.cholesky(covariance + ridge * np.eye(x.shape[1])))
    return Mixture(counts / counts.sum(), means, np.stack(factors))


def _nearest_seed(x: np.ndarray, components: int, rng: np.random.Generator) -> np.ndarray:
    """Return the index (N,) of the nearest among K distant points that k-means++ draws."""
    chosen = [x[rng.integers(len(x))]]
    for _ in range(components - 1):
        distance = np.min([((x - c) ** 2).sum(axis=1) for c in chosen], axis=0)
        chosen.append(x[rng.choice(len(x), p=distance / distance.sum())])
    return np.argmin([((x - c) ** 2).sum(axis=1) for c in chosen], axis=0)


COMPONENTS = 8
RIDGE = 1e-3
"""Value in rad² added to every variance. A joint that never bends in recordings may then bend by 1.8 degrees."""
_CARD = Card(
    "Gaussian mixture",
    """This prior is a mixture of eight Gaussians over the rotation vectors of the 21 body joints (Bogo et al. 2016). It
is fitted by expectation maximisation to the distinct poses and their mirror images, without further augmentation.""",
    augmented=False,
)


def train_gmm(job: TrainingJob) -> Finished:
    """Train the Gaussian mixture prior, export its weights and write the model card.

    Raises:
        JobInvalid: the device is not the CPU.
    """
    if job.settings.device != "cpu":
        raise JobInvalid("The mixture can only be fitted on the CPU.", where="device", hint="Omit --device.")
    x = rotation_vectors(job.training)
    mixture, history = fit_mixture(x, COMPONENTS, job.settings.seed, ridge=RIDGE, progress=job.progress)
    arrays = {
        "weights": mixture.weights.astype(np.float32),
        "means": mixture.means.astype(np.float32),
        "factors": mixture.factors.astype(np.float32),
    }
    held_out = mixture.log_densities(rotation_vectors(job.validation))
    metrics = {
        "train_log_likelihood_nats": history[-1],
        "validation_log_likelihood_nats": float(np.logaddexp.reduce(held_out, axis=1).mean()),
    }
    settings = {"components": COMPONENTS, "ridge": RIDGE, "seed": job.settings.seed}

    def measure(path: Path) -> dict[str, Any]:
        load_gmm(path)
        return {"metrics": metrics}

    return publish(job, "gmm", arrays, {}, settings, measure, _CARD)


def rotation_vectors(corpus: Corpus) -> np.ndarray:
    """Return rotation vectors (2 D, 63) in radians of the distinct poses and of their mirror images."""
    vectors = log_so3(corpus.rotations[corpus.distinct].astype(np.float64))
    flipped = vectors[:, BODY_MIRROR] * np.array([1.0, -1.0, -1.0])
    return np.concatenate((vectors, flipped)).reshape(-1, 3 * NUM_BODY_JOINTS)
