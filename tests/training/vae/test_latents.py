"""Codes of the variational autoencoders: draws follow their densities, divergences are those densities'."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import ive

from solver_backend.geometry.rotations import log_so3, matrix_from_6d
from training.vae import train
from training.vae.train import ROTATIONS, SPHERE_DIM, GaussianLatent, RotationLatent, SphereLatent


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_gaussian_divergence_is_zero_at_the_prior() -> None:
    z, nats = GaussianLatent().draw(torch.zeros(4000, 64), generator())
    assert float(nats.abs().max()) == 0.0
    assert float(z.mean().abs()) < 0.01 and float(z.std()) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("raw", [-3.0, 20.0, 400.0])
def test_directions_follow_von_mises_fisher(raw: float) -> None:
    out = torch.randn(1, SPHERE_DIM + 1, generator=generator()).repeat(6000, 1)
    out[:, -1] = raw
    z, _ = SphereLatent().draw(out, generator())
    kappa = 1.0 + math.log1p(math.exp(-abs(raw))) + max(raw, 0.0)
    torch.testing.assert_close(torch.linalg.vector_norm(z, dim=-1), torch.ones(len(z)), atol=1e-4, rtol=0)
    along = (z * SphereLatent().mean(out)).sum(-1)
    half = SPHERE_DIM / 2
    expected = float(ive(half, kappa) / ive(half - 1, kappa))
    assert float(along.mean()) == pytest.approx(expected, abs=8e-3)


def test_direction_divergence_and_its_slope() -> None:
    kappa = torch.tensor([1.0, 8.0, 50.0, 700.0], dtype=torch.float64, requires_grad=True)
    nats = train.SphereDivergence.apply(kappa)
    nats.sum().backward()
    nats = nats.detach()
    ahead, behind = (train.SphereDivergence.apply(kappa.detach() + s * 1e-4) for s in (1, -1))
    np.testing.assert_allclose(kappa.grad.numpy(), ((ahead - behind) / 2e-4).numpy(), rtol=1e-5)
    assert 0 < float(nats[0]) < 0.05 and (nats.diff() > 0).all()
    # A sharp density on a sphere of 31 dimensions is a normal of variance 1/κ there.
    area = math.log(2.0) + 16 * math.log(math.pi) - math.lgamma(16.0)
    normal = area - 0.5 * 31 * (1.0 + math.log(2 * math.pi / 700.0))
    assert float(nats[3]) == pytest.approx(normal, abs=0.4)


def test_rotations_are_drawn_about_their_mean() -> None:
    out = torch.randn(1, 9 * ROTATIONS, generator=generator()).repeat(4000, 1)
    sigma = 0.1
    out[:, 6 * ROTATIONS :] = 2.0 * math.log(sigma)
    z, nats = RotationLatent().draw(out, generator())
    R = z.unflatten(-1, (ROTATIONS, 3, 3))
    eye = torch.eye(3).expand_as(R)
    torch.testing.assert_close(R @ R.transpose(-1, -2), eye, atol=1e-5, rtol=0)
    mean = matrix_from_6d(out[:, : 6 * ROTATIONS].unflatten(-1, (ROTATIONS, 6)))
    turn = log_so3(mean.transpose(-1, -2) @ R)
    assert float(turn.std()) == pytest.approx(sigma, rel=0.02)
    entropy = 1.5 * (1.0 + math.log(2 * math.pi)) + 3 * math.log(sigma)
    expected = ROTATIONS * (math.log(8 * math.pi**2) - entropy)
    assert float(nats.mean()) == pytest.approx(expected, rel=0.01)


def test_wrapped_density_has_mass_one() -> None:
    quats = torch.nn.functional.normalize(torch.randn(200000, 4, generator=generator()), dim=-1)
    angle = 2 * torch.acos(quats[:, :1].abs().clamp(max=1.0))
    axis = torch.nn.functional.normalize(quats[:, 1:], dim=-1)
    for sigma in (0.7, 1.5):
        density = train._wrapped_log_density(angle * axis, torch.full((1, 3), math.log(sigma))).exp()
        assert float(density.mean()) * 8 * math.pi**2 == pytest.approx(1.0, abs=0.03)
