"""Train the variational autoencoders, from the corpus to the weights."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, cast

import numpy as np
import torch
from scipy.special import gammaln, ive
from torch import nn

from research.priors import load_prior
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.rotations import exp_so3, log_so3, matrix_from_6d
from solver_backend.priors.base import AutoencodingPrior
from training.data.corpus import Corpus, WindowSampler
from training.engine.accuracy import (
    VALIDATION_POSES,
    accuracy_by_source,
    autoencoder_arrays,
    pose_loss,
    reconstructed,
    reconstruction_accuracy,
)
from training.engine.dense_layers import linear_layers
from training.engine.loop import device_of, run_training
from training.engine.publish import Card, Figures, Finished, TrainingJob, publish

Kind = Literal["vposer", "vposer_worded", "rvposer", "rvposer_second_norm", "svae", "lie_vae"]
GAUSSIAN_DIM = 32
SPHERE_DIM = 32
ROTATIONS = 10
"""Number of rotations in a code of the Lie group. Ten rotations have 30 dimensions, like SPoser's codes."""
_LOG_VARIANCE = (-12.0, 6.0)  # Range of a log-variance that keeps exponentials finite. Chosen by hand.


class Latent(Protocol):
    """Interface of a latent space: the posterior over codes, described by an encoder's outputs."""

    outputs: int  # Size of the encoder's output.
    width: int  # Size of the decoder's input.

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the codes (N, width) of encoder outputs (N, outputs)."""
        ...

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Return a draw (N, width) of the posterior, and its divergence (N,) from the prior in nats."""
        ...


class GaussianLatent:
    """Codes are vectors. The prior is standard normal (Kingma & Welling 2014)."""

    outputs, width = 2 * GAUSSIAN_DIM, GAUSSIAN_DIM

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the mean codes of the posterior."""
        return out[:, :GAUSSIAN_DIM]

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw codes from the posterior by reparametrisation, and return their divergence in nats."""
        mean, log_variance = out[:, :GAUSSIAN_DIM], out[:, GAUSSIAN_DIM:].clamp(*_LOG_VARIANCE)
        noise = torch.randn(mean.shape, generator=generator).to(mean.device)
        nats = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(-1)
        return mean + torch.exp(0.5 * log_variance) * noise, nats


class SphereLatent:
    """Codes are directions with a von Mises-Fisher posterior and a uniform prior (Davidson et al. 2018)."""

    outputs, width = SPHERE_DIM + 1, SPHERE_DIM

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the mean directions of the posterior."""
        return torch.nn.functional.normalize(out[:, :SPHERE_DIM], dim=-1)

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw by rejection (Ulrich 1984): ``z = w μ + sqrt(1 - w²) v``, where v is a unit vector normal to μ."""
        mean, kappa = self.mean(out), 1.0 + torch.nn.functional.softplus(out[:, SPHERE_DIM])
        w = _along_mean(kappa, generator)[:, None]
        across = torch.randn(mean.shape, generator=generator).to(mean.device)
        across = torch.nn.functional.normalize(across - (across * mean).sum(-1, keepdim=True) * mean, dim=-1)
        return w * mean + torch.sqrt((1.0 - w * w).clamp_min(1e-9)) * across, SphereDivergence.apply(kappa)


class RotationLatent:
    """Codes are rotations with a normal posterior in the tangent space. The prior is uniform (Falorsi et al. 2018)."""

    outputs, width = 9 * ROTATIONS, 9 * ROTATIONS

    def mean(self, out: torch.Tensor) -> torch.Tensor:
        """Return the matrix entries of the posterior's mean rotations."""
        return self._means(out).flatten(1)

    def draw(self, out: torch.Tensor, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw ``R_μ exp(σ ε)``. The divergence is estimated at the draw, with a density wrapped twice."""
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
"""Latent space of each autoencoder."""


class SphereDivergence(torch.autograd.Function):
    """Divergence of a von Mises-Fisher distribution from the uniform one, and its derivative ``κ A'(κ)``.

    ``KL(vMF(κ) | uniform) = κ A(κ) + log C(κ) + log area`` with ``A = I_{m/2} / I_{m/2-1}`` in m dimensions.
    """

    @staticmethod
    def forward(ctx: Any, kappa: torch.Tensor) -> torch.Tensor:
        """Return the divergence in nats of (N,) concentrations."""
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
        """Return the gradient w.r.t. the concentrations."""
        return grads[0] * ctx.saved_tensors[0]


def _along_mean(kappa: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Draw the components (N,) of unit vectors along the mean direction.

    They are ``w(ε) = (1 - (1+b) ε) / (1 - (1-b) ε)``, where ε is accepted from a beta distribution.
    """
    accepted = _accepted(kappa.detach().cpu(), generator).to(kappa.device)
    b = _breadth(kappa)
    return (1.0 - (1.0 + b) * accepted) / (1.0 - (1.0 - b) * accepted)


def _breadth(kappa: torch.Tensor) -> torch.Tensor:
    """Return Ulrich's ``b = m / (2 κ + sqrt(4 κ² + m²))``."""
    m = SPHERE_DIM - 1
    return m / (2.0 * kappa + torch.sqrt(4.0 * kappa.square() + m * m))


def _accepted(kappa: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Draw the values ε (N,) that the rejection step accepts, on the generator's device."""
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
    """Return the log density (N, K) of exp(turn) with respect to the Haar measure, which has a mass of 8π²."""
    angle = torch.linalg.vector_norm(turn, dim=-1, keepdim=True).clamp_min(1e-6)
    terms = []
    for wraps in (-1, 0, 1):
        scale = (angle + 2.0 * math.pi * wraps) / angle
        normal = -0.5 * (scale * turn * torch.exp(-log_sigma)).square() - log_sigma - 0.5 * math.log(2.0 * math.pi)
        length = (angle * scale).abs()[..., 0]
        terms.append(normal.sum(-1) + 2.0 * torch.log(length))
    haar = 4.0 * torch.sin(0.5 * angle[..., 0]).square()
    return torch.logsumexp(torch.stack(terms), dim=0) - torch.log(haar.clamp_min(1e-12))


HIDDEN = 512  # Width of the layers, as in VPoser (Pavlakos et al. 2019).
_DROPOUT = 0.1  # Dropout rate, as in VPoser.
_INPUTS = 3 * NUM_BODY_JOINTS  # Length of a pose as rotation vectors.


@dataclass(frozen=True)
class VaeForm:
    """Variants of the autoencoder's layers and penalty."""

    first_norm: bool = False  # Apply batch normalisation before the encoder's first layer.
    second_norm: bool = False  # Apply batch normalisation after the encoder's first activation.
    decoder_dropout: bool = False
    last_activation: bool = False  # Apply an activation after the decoder's last layer.
    charbonnier: bool = False  # Use the Charbonnier penalty of the divergence (thesis eq. 4.17).


FORMS: dict[Kind, VaeForm] = {
    "vposer": VaeForm(first_norm=True, second_norm=True, decoder_dropout=True),
    "vposer_worded": VaeForm(first_norm=True, decoder_dropout=True, last_activation=True),
    "rvposer": VaeForm(charbonnier=True),
    "rvposer_second_norm": VaeForm(second_norm=True, charbonnier=True),
    "svae": VaeForm(),
    "lie_vae": VaeForm(),
}
"""VPoser as in its public code and as in the thesis (4.2.4), and RVPoser without normalisation and with the second
normalisation, which the thesis does not mention."""


@dataclass(frozen=True)
class VaeSettings:
    """Kind of variational autoencoder, and weights of its losses."""

    kind: Kind
    divergence: float = 1e-3
    """Weight of the Kullback-Leibler divergence in nats, or of its Charbonnier penalty (thesis eq. 4.17)."""
    orthogonality: float = 0.5  # Weight of the difference between rotations (thesis eq. 4.19).


class VariationalAutoencoder(nn.Module):
    """Variational autoencoder: encoder 63 -> 512 -> 512 -> posterior, decoder code -> 512 -> 512 -> 126."""

    def __init__(self, kind: Kind) -> None:
        super().__init__()
        form = FORMS[kind]
        self.latent = LATENTS[kind]()
        self.norm = nn.BatchNorm1d(_INPUTS) if form.first_norm else nn.Identity()
        self.second_norm = nn.BatchNorm1d(HIDDEN) if form.second_norm else nn.Identity()
        self.encoder = nn.Sequential(
            nn.Linear(_INPUTS, HIDDEN),
            nn.LeakyReLU(),
            self.second_norm,
            nn.Dropout(_DROPOUT),
            nn.Linear(HIDDEN, HIDDEN),
            nn.LeakyReLU(),
            nn.Linear(HIDDEN, self.latent.outputs),
        )
        self.decoder = nn.Sequential(
            nn.Linear(self.latent.width, HIDDEN),
            nn.LeakyReLU(),
            nn.Dropout(_DROPOUT if form.decoder_dropout else 0.0),
            nn.Linear(HIDDEN, HIDDEN),
            nn.LeakyReLU(),
            nn.Linear(HIDDEN, 6 * NUM_BODY_JOINTS),
            nn.LeakyReLU() if form.last_activation else nn.Identity(),
        )

    def posterior(self, rotations: torch.Tensor) -> torch.Tensor:
        """Return the encoder's outputs for poses (N, 21, 3, 3)."""
        return self.encoder(self.norm(log_so3(rotations).flatten(-2)))

    def encode(self, rotations: torch.Tensor) -> torch.Tensor:
        """Return the codes of poses (N, 21, 3, 3) without noise."""
        return self.latent.mean(self.posterior(rotations))

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """Decode codes (N, width) to poses (N, 21, 3, 3)."""
        return matrix_from_6d(self.decoder(z).unflatten(-1, (NUM_BODY_JOINTS, 6)))


class VaeTask:
    """Losses of the variational autoencoders (thesis eqs. 4.16 to 4.19), and validation."""

    def __init__(self, train: Corpus, validation: Corpus, settings: VaeSettings, batch: int, seed: int) -> None:
        torch.manual_seed(seed)
        self.model = VariationalAutoencoder(settings.kind)
        self._sampler, self._settings, self._batch = WindowSampler.of(train), settings, batch
        self._validation = validation.some_distinct(VALIDATION_POSES).astype(np.float64)

    def draw(self, generator: torch.Generator) -> torch.Tensor:
        """Draw poses: the middle key and the intermediate frame of each window."""
        return self._sampler.draw(self._batch, generator).rotations[:, [1, 3]].flatten(0, 1)

    def loss(self, batch: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Return the reconstruction loss of a batch plus the weighted divergence of its codes."""
        s, truth = self._settings, batch.to(device_of(self.model))
        self.model.train()
        z, nats = self.model.latent.draw(self.model.posterior(truth), generator)
        decoded = self.model.decode(z)
        penalty = torch.sqrt(1.0 + nats.square()) - 1.0 if FORMS[s.kind].charbonnier else nats
        evenly = torch.ones(len(truth), device=truth.device)
        return pose_loss(truth, decoded, evenly, s.orthogonality) + s.divergence * penalty.mean()

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return reconstruction figures on the validation poses, using codes without noise."""
        decoded = reconstructed(cast(VariationalAutoencoder, model), self._validation)
        return reconstruction_accuracy(self._validation, decoded).as_dict()


_SUMMARIES: dict[Kind, str] = {
    "vposer": """VPoser (Pavlakos et al. 2019) as in its public code, retrained on our corpus. It is a variational
autoencoder of the 21 body joints' rotations with a standard normal code of 32 dimensions. It has batch normalisation
before the encoder's first and second layer, and dropout in the decoder.""",
    "vposer_worded": """VPoser as described in the thesis (4.2.4), retrained on our corpus. It has batch normalisation
before the first layer alone. After the decoder's last layer it has an activation that the public code lacks.""",
    "rvposer": """RVPoser (thesis 4.2.4) is VPoser without batch normalisation, decoder dropout and last activation. Its
divergence has a Charbonnier penalty (4.16-4.19).""",
    "rvposer_second_norm": """RVPoser (thesis 4.2.4) in a literal reading: only the first of the public code's two batch
normalisations is removed. Its divergence has a Charbonnier penalty (4.16-4.19).""",
    "svae": """SVAE (Davidson et al. 2018, thesis table 6.5) is a variational autoencoder of the 21 body joints'
rotations. Its codes are unit vectors in R^32, von Mises-Fisher about each pose's direction and uniform over all poses.
It has RVPoser's layers.""",
    "lie_vae": """LieVAE (Falorsi et al. 2018, thesis table 6.5) is a variational autoencoder of the 21 body joints'
rotations. Its codes are ten rotations, normal in the tangent space at each pose's code and uniform on the group over
all poses. It has RVPoser's layers.""",
}
_TITLES: dict[Kind, str] = {
    "vposer": "VPoser",
    "vposer_worded": "VPoser as worded",
    "rvposer": "RVPoser",
    "rvposer_second_norm": "RVPoser with the second normalisation",
    "svae": "SVAE",
    "lie_vae": "LieVAE",
}


def train_vae(kind: Kind, job: TrainingJob) -> Finished:
    """Train one of the variational autoencoders, export its weights, measure them and write the model card."""
    settings = VaeSettings(kind)
    task = VaeTask(job.training, job.validation, settings, job.settings.batch, job.settings.seed)
    model = cast(VariationalAutoencoder, run_training(task, job.settings, job.work, job.progress))
    truth = job.validation.rotations[job.validation.distinct].astype(np.float64)
    arrays = autoencoder_arrays(model, folded_encoder(model), model.decoder, truth)
    header = {
        "encoder_hidden": (HIDDEN, HIDDEN),
        "decoder_hidden": (HIDDEN, HIDDEN),
        "activation": "leaky_relu",
        "activate_last": FORMS[kind].last_activation,
    }
    asked = asdict(settings) | asdict(job.settings)

    def measured(path: Path) -> Figures:
        prior = cast(AutoencodingPrior, load_prior(kind, path))
        by_source = accuracy_by_source(job.validation, prior.reconstruct)
        return {"metrics": reconstruction_accuracy(truth, prior.reconstruct(truth)).as_dict(), "by_source": by_source}

    return publish(job, kind, arrays, header, asked, measured, Card(_TITLES[kind], _SUMMARIES[kind]))


def folded_encoder(model: VariationalAutoencoder) -> nn.Sequential:
    """Return the encoder with the scale and shift of each batch normalisation merged into the layer after it."""
    first, *rest = linear_layers(model.encoder)
    return nn.Sequential(_folded(model.norm, first), _folded(model.second_norm, rest[0]), *rest[1:])


def _folded(norm: nn.Module, layer: nn.Linear) -> nn.Linear:
    """Merge a normalisation into the layer that follows: ``W ((x - m) s + b) + c``."""
    if not isinstance(norm, nn.BatchNorm1d):
        return layer
    mean, variance = cast(torch.Tensor, norm.running_mean), cast(torch.Tensor, norm.running_var)
    scale = norm.weight / torch.sqrt(variance + norm.eps)
    folded = nn.Linear(layer.in_features, layer.out_features)
    with torch.no_grad():
        folded.weight.copy_(layer.weight * scale)
        folded.bias.copy_(layer.bias + layer.weight @ (norm.bias - mean * scale))
    return folded
