"""RVPoser as shipped: Jacobian, NumPy against torch, energy, and bad weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.exchange.errors import FileMissing, PoseInvalid, WeightsInvalid
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.gaussian_vae import LATENT_DIM, GaussianVAE, load_vae
from solver_backend.priors.weights import ASSETS


@pytest.fixture(scope="module")
def prior() -> GaussianVAE:
    return load_vae("rvposer")


def test_jacobian_against_central_differences(prior: GaussianVAE) -> None:
    z, step = np.random.default_rng(0).standard_normal((4, LATENT_DIM)), 1e-6
    R, J = prior.decode_with_jacobian(z)
    np.testing.assert_allclose(R, prior.decode(z), atol=1e-12)
    for i in range(LATENT_DIM):
        d = step * np.eye(LATENT_DIM)[i]
        turn = log_so3(prior.decode(z + d) @ np.swapaxes(prior.decode(z - d), -1, -2)) / (2 * step)
        assert np.abs(J[..., i] - turn).max() < 1e-6 * np.abs(J).max()


def test_numpy_against_torch(prior: GaussianVAE) -> None:
    R = prior.sample(5, seed=1)
    np.testing.assert_allclose(prior.encode(torch.as_tensor(R)).numpy(), prior.encode(R), atol=1e-10)
    z = prior.encode(R)
    np.testing.assert_allclose(prior.decode(torch.as_tensor(z)).numpy(), prior.decode(z), atol=1e-10)


def test_energy_is_half_the_squared_code_and_tells_broken_poses(prior: GaussianVAE) -> None:
    R = prior.sample(60, seed=2)
    z, deviation = prior.posterior(R)
    np.testing.assert_allclose(prior.energy(R), 0.5 * (z * z).sum(axis=1))
    assert z.shape == (60, LATENT_DIM) and (deviation > 0).all()
    broken = exp_so3(1.5 * np.random.default_rng(3).standard_normal((60, 21, 3)))
    assert np.median(prior.energy(broken)) > 2 * np.median(prior.energy(R))


@pytest.mark.misshapen
def test_bad_input_is_named(prior: GaussianVAE, tmp_path: Path) -> None:
    with pytest.raises(PoseInvalid, match=r"shape \(N, 32\)"):
        prior.decode(np.zeros((1, 30)))
    with pytest.raises(PoseInvalid, match=r"not \(2, 23, 3, 3\)"):
        prior.encode(np.zeros((2, 23, 3, 3)))
    with pytest.raises(WeightsInvalid, match="for the prior 'sposer', not 'rvposer'"):
        load_vae("rvposer", ASSETS / "sposer.npz")
    with pytest.raises(FileMissing, match="weights of vposer"):
        load_vae("vposer", tmp_path / "vposer.npz")


def test_shipped_weights_are_described(prior: GaussianVAE) -> None:
    card = (ASSETS / "rvposer.md").read_text(encoding="utf-8")
    options = prior.metadata["command"].partition(" --")[2]  # the verb has another group now
    assert prior.metadata["sha256"] in card and f"manifold train model rvposer --{options}" in card
    assert prior.metadata["metrics"]["mpjpe_mm"] < 20.0 and (ASSETS / "rvposer.npz").stat().st_size < 4_000_000
