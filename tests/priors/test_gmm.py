"""The Gaussian mixture: densities against SciPy, Jacobian, samples, and bad weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from research.priors import GaussianMixture, load_gmm
from solver_backend.exchange.errors import PoseInvalid, WeightsInvalid
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import ASSETS, PriorWeights, write_weights


def mixture_arrays(components: int = 3) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    weights = rng.uniform(1, 2, components)
    factors = np.tril(0.02 * rng.standard_normal((components, 63, 63)))
    factors[:, np.arange(63), np.arange(63)] = rng.uniform(0.1, 0.2, (components, 63))
    return {
        "weights": weights / weights.sum(),
        "means": 0.3 * rng.standard_normal((components, 63)),
        "factors": factors,
    }


@pytest.fixture
def prior() -> GaussianMixture:
    return GaussianMixture(**mixture_arrays(), metadata={})


def test_energy_is_the_negative_log_density(prior: GaussianMixture) -> None:
    stored = mixture_arrays()
    x = stored["means"][[0, 1, 2, 2]] + 0.1 * np.random.default_rng(1).standard_normal((4, 63))
    normals = [multivariate_normal(m, L @ L.T) for m, L in zip(stored["means"], stored["factors"], strict=True)]
    density = sum(w * n.pdf(x) for w, n in zip(stored["weights"], normals, strict=True))
    peak = sum(w * n.pdf(n.mean) for w, n in zip(stored["weights"], normals, strict=True))
    energy = prior.energy(exp_so3(x.reshape(4, 21, 3)))
    np.testing.assert_allclose(energy, np.log(peak) - np.log(density), rtol=1e-8)
    assert (energy > 0).all()


def test_jacobian_against_central_differences(prior: GaussianMixture) -> None:
    z, step = 0.8 * np.random.default_rng(2).standard_normal((3, 63)), 1e-5
    R, J = prior.decode_with_jacobian(z)
    for i in range(63):
        d = step * np.eye(63)[i]
        turn = log_so3(prior.decode(z + d) @ np.swapaxes(prior.decode(z - d), -1, -2)) / (2 * step)
        np.testing.assert_allclose(J[..., i], turn, atol=1e-8)
    np.testing.assert_allclose(exp_so3(prior.encode(R).reshape(3, 21, 3)), R, atol=1e-12)


def test_numpy_against_torch(prior: GaussianMixture) -> None:
    R = prior.sample(6, seed=3)
    np.testing.assert_allclose(prior.energy(torch.as_tensor(R)).numpy(), prior.energy(R), rtol=1e-9)


def test_samples_have_the_mixtures_moments() -> None:
    stored = mixture_arrays(1)
    prior = GaussianMixture(**stored, metadata={})
    x = prior.encode(prior.sample(3000, seed=4))
    covariance = stored["factors"][0] @ stored["factors"][0].T
    np.testing.assert_allclose(x.mean(axis=0), stored["means"][0], atol=0.02)
    np.testing.assert_allclose(np.cov(x, rowvar=False), covariance, atol=0.006)


def test_bad_input_is_named(tmp_path: Path, prior: GaussianMixture) -> None:
    with pytest.raises(PoseInvalid, match=r"shape \(N, 63\)"):
        prior.decode(np.zeros((2, 32)))
    path, arrays = tmp_path / "gmm.npz", mixture_arrays()
    for change, text in (
        ({"weights": np.full(3, 0.5)}, "must be positive and add up to 1"),
        ({"means": np.zeros((2, 63))}, "means.*shape"),
        ({"factors": np.zeros((3, 63, 63))}, "singular"),
    ):
        write_weights(path, PriorWeights("gmm", arrays | change, {}))
        with pytest.raises(WeightsInvalid, match=text):
            load_gmm(path)
    write_weights(path, PriorWeights("gmm", arrays, {}))
    assert load_gmm(path).latent_dim == 63


def test_shipped_mixture_prefers_people() -> None:
    shipped, sposer = load_gmm(), load_sposer()
    posed = shipped.energy(sposer.sample(100, seed=0))
    noise = shipped.energy(exp_so3(0.8 * np.random.default_rng(0).standard_normal((100, 21, 3))))
    assert np.median(noise) > 3 * np.median(posed)
    assert shipped.metadata["sha256"] in (ASSETS / "gmm.md").read_text(encoding="utf-8")
