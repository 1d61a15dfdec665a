"""What the codes of a variational autoencoder are: vectors, directions or rotations, and how they are drawn."""

from __future__ import annotations

import math
from typing import Any, Literal, Protocol

import numpy as np
import torch
from scipy.special import gammaln, ive

from solver_backend.geometry.rotations import exp_so3, matrix_from_6d

Kind = Literal["vposer", "vposer_worded", "rvposer", "rvposer_second_norm", "svae", "lie_vae"]
GAUSSIAN_DIM = 32
SPHERE_DIM = 32
ROTATIONS = 10
"""Factors of the Lie group: 30 dimensions, as SPoser has."""
_LOG_VARIANCE = (-12.0, 6.0)
"""Range of a log-variance, which keeps exponentials finite; chosen by hand."""


class Latent(Protocol):
    """The posterior over codes that an encoder's outputs stand for."""

    outputs: int
    """Numbers the encoder gives."""
    width: int
    """Numbers the decoder takes."""

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the (N, width) code of (N, outputs) encoder outputs."""
        ...

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Return a (N, width) draw of the posterior and its (N,) divergence from the prior, nats."""
        ...


class GaussianLatent:
    """Vectors; the prior is standard normal (Kingma & Welling 2014)."""

    outputs, width = 2 * GAUSSIAN_DIM, GAUSSIAN_DIM

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the posterior's mean."""
        return out[:, :GAUSSIAN_DIM]

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw by reparametrisation."""
        mean, log_variance = out[:, :GAUSSIAN_DIM], out[:, GAUSSIAN_DIM:].clamp(*_LOG_VARIANCE)
        noise = torch.randn(mean.shape, generator=generator).to(mean.device)
        nats = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(-1)
        return mean + torch.exp(0.5 * log_variance) * noise, nats


class SphereLatent:
    """Directions with a von Mises-Fisher posterior; the prior is uniform on the sphere (Davidson et al. 2018)."""

    outputs, width = SPHERE_DIM + 1, SPHERE_DIM

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the mean direction."""
        return torch.nn.functional.normalize(out[:, :SPHERE_DIM], dim=-1)

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw by rejection (Ulrich 1984): ``z = w μ + sqrt(1 - w²) v``, v a unit vector across μ."""
        mean, kappa = self.mean(out), 1.0 + torch.nn.functional.softplus(out[:, SPHERE_DIM])
        w = _along_mean(kappa, generator)[:, None]
        across = torch.randn(mean.shape, generator=generator).to(mean.device)
        across = torch.nn.functional.normalize(across - (across * mean).sum(-1, keepdim=True) * mean, dim=-1)
        return w * mean + torch.sqrt((1.0 - w * w).clamp_min(1e-9)) * across, SphereDivergence.apply(kappa)


class RotationLatent:
    """Rotations with a normal posterior in the tangent space; the prior is uniform (Falorsi et al. 2018)."""

    outputs, width = 9 * ROTATIONS, 9 * ROTATIONS

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the mean rotations' entries."""
        return self._means(out).flatten(1)

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw ``R_μ exp(σ ε)``; the divergence is estimated at the draw, its density wrapped twice around."""
        log_sigma = 0.5 * out[:, 6 * ROTATIONS :].clamp(*_LOG_VARIANCE).unflatten(-1, (ROTATIONS, 3))
        noise = torch.randn(log_sigma.shape, generator=generator).to(log_sigma.device)
        turn = torch.exp(log_sigma) * noise
        z = torch.matmul(self._means(out), exp_so3(turn)).flatten(1)
        return z, (_wrapped_log_density(turn, log_sigma) + math.log(8.0 * math.pi**2)).sum(-1)

    def _means(self, out: torch.Tensor) -> torch.Tensor:
        return matrix_from_6d(out[:, : 6 * ROTATIONS].unflatten(-1, (ROTATIONS, 6)))


LATENTS: dict[Kind, type[Latent]] = {
    "vposer": GaussianLatent,
    "vposer_worded": GaussianLatent,
    "rvposer": GaussianLatent,
    "rvposer_second_norm": GaussianLatent,
    "svae": SphereLatent,
    "lie_vae": RotationLatent,
}
"""The codes of each autoencoder."""


class SphereDivergence(torch.autograd.Function):
    """``KL(vMF(κ) | uniform) = κ A(κ) + log C(κ) + log area``, ``A = I_{m/2} / I_{m/2-1}``, slope ``κ A'(κ)``."""

    @staticmethod
    def forward(ctx: Any, kappa: torch.Tensor) -> torch.Tensor:
        """Return nats of (N,) concentrations."""
        k, half = kappa.detach().cpu().numpy().astype(np.float64), SPHERE_DIM / 2
        scaled = ive(half - 1, k)
        ratio = ive(half, k) / scaled
        log_c = (half - 1) * np.log(k) - half * np.log(2 * np.pi) - (np.log(scaled) + k)
        log_area = np.log(2.0) + half * np.log(np.pi) - gammaln(half)
        slope = k * (1.0 - ratio**2 - (SPHERE_DIM - 1) / k * ratio)
        ctx.save_for_backward(torch.as_tensor(slope, dtype=kappa.dtype, device=kappa.device))
        return torch.as_tensor(k * ratio + log_c + log_area, dtype=kappa.dtype, device=kappa.device)

    @staticmethod
    def backward(ctx: Any, *grads: torch.Tensor) -> torch.Tensor:
        """Return the slope by the concentration."""
        return grads[0] * ctx.saved_tensors[0]


def _along_mean(kappa: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return (N,) components along the mean; ``w(ε) = (1 - (1+b) ε) / (1 - (1-b) ε)``, ε accepted from a beta law."""
    accepted = _accepted(kappa.detach().cpu(), generator).to(kappa.device)
    b = _breadth(kappa)
    return (1.0 - (1.0 + b) * accepted) / (1.0 - (1.0 - b) * accepted)


def _breadth(kappa: torch.Tensor) -> torch.Tensor:
    """Return Ulrich's ``b = m / (2 κ + sqrt(4 κ² + m²))``."""
    m = SPHERE_DIM - 1
    return m / (2.0 * kappa + torch.sqrt(4.0 * kappa.square() + m * m))


def _accepted(kappa: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Return (N,) draws ε that the rejection step keeps, on the generator's device."""
    m, b = SPHERE_DIM - 1, _breadth(kappa)
    centre = (1.0 - b) / (1.0 + b)
    level = kappa * centre + m * torch.log(1.0 - centre.square())
    accepted = torch.zeros_like(kappa)
    waiting = torch.arange(len(kappa))
    while len(waiting):
        direction = torch.randn(len(waiting), SPHERE_DIM, generator=generator)
        epsilon = 0.5 + 0.5 * direction[:, 0] / torch.linalg.vector_norm(direction, dim=-1)
        at = b[waiting]
        w = (1.0 - (1.0 + at) * epsilon) / (1.0 - (1.0 - at) * epsilon)
        gain = kappa[waiting] * w + m * torch.log(1.0 - centre[waiting] * w) - level[waiting]
        kept = gain >= torch.log(torch.rand(len(waiting), generator=generator))
        accepted[waiting[kept]] = epsilon[kept]
        waiting = waiting[~kept]
    return accepted


def _wrapped_log_density(turn: torch.Tensor, log_sigma: torch.Tensor) -> torch.Tensor:
    """Return the log density of exp(turn) by the Haar measure of mass 8π², (N, K)."""
    angle = torch.linalg.vector_norm(turn, dim=-1, keepdim=True).clamp_min(1e-6)
    terms = []
    for wraps in (-1, 0, 1):
        scale = (angle + 2.0 * math.pi * wraps) / angle
        normal = -0.5 * (scale * turn * torch.exp(-log_sigma)).square() - log_sigma - 0.5 * math.log(2.0 * math.pi)
        length = (angle * scale).abs()[..., 0]
        terms.append(normal.sum(-1) + 2.0 * torch.log(length))
    haar = 4.0 * torch.sin(0.5 * angle[..., 0]).square()
    return torch.logsumexp(torch.stack(terms), dim=0) - torch.log(haar.clamp_min(1e-12))
