"""VPoser's and RVPoser's networks and losses in torch (Pavlakos et al. 2019; thesis 4.2.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast

import numpy as np
import torch
from torch import nn

from solver_backend.geometry.rotations import log_so3, matrix_from_6d
from solver_backend.training.accuracy import reconstruction_accuracy
from solver_backend.training.corpus import Corpus
from solver_backend.training.sposer import pose_loss
from solver_backend.training.windows import WindowSampler

LATENT = 32
HIDDEN = 512
_DROPOUT = 0.1


@dataclass(frozen=True)
class VaeSettings:
    """What tells RVPoser from VPoser, and the losses' weights."""

    kind: Literal["vposer", "rvposer"]
    divergence: float = 1e-3
    """Weight of the Kullback-Leibler divergence (nats), or of its Charbonnier penalty (4.17)."""
    orthogonality: float = 0.5
    """Weight of (4.19)."""


class VariationalAutoencoder(nn.Module):
    """63 -> 512 -> 512 -> mean and log-variance of 32; 32 -> 512 -> 512 -> 126.

    VPoser has batch normalisation before its first layer, dropout in encoder and decoder and an activation after the
    decoder's last layer; RVPoser has only the encoder's dropout.
    """

    def __init__(self, kind: Literal["vposer", "rvposer"]) -> None:
        super().__init__()
        published = kind == "vposer"
        self.norm = nn.BatchNorm1d(63) if published else nn.Identity()
        self.encoder = nn.Sequential(
            nn.Linear(63, HIDDEN), nn.LeakyReLU(), nn.Dropout(_DROPOUT), nn.Linear(HIDDEN, HIDDEN), nn.LeakyReLU(),
            nn.Linear(HIDDEN, 2 * LATENT),
        )  # fmt: skip
        self.decoder = nn.Sequential(
            nn.Linear(LATENT, HIDDEN), nn.LeakyReLU(), nn.Dropout(_DROPOUT if published else 0.0),
            nn.Linear(HIDDEN, HIDDEN), nn.LeakyReLU(), nn.Linear(HIDDEN, 126),
            nn.LeakyReLU() if published else nn.Identity(),
        )  # fmt: skip

    def posterior(self, rotations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and log-variance (N, 32) of (N, 21, 3, 3) poses."""
        out = self.encoder(self.norm(log_so3(rotations).flatten(-2)))
        return out[:, :LATENT], out[:, LATENT:].clamp(-12.0, 6.0)

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """(N, 32) -> (N, 21, 3, 3)."""
        return matrix_from_6d(self.decoder(z).unflatten(-1, (21, 6)))


class VaeTask:
    """Losses (4.16)-(4.19) and validation."""

    def __init__(self, train: Corpus, validation: Corpus, settings: VaeSettings, batch: int, seed: int) -> None:
        torch.manual_seed(seed)
        self.model = VariationalAutoencoder(settings.kind)
        self._sampler, self._settings, self._batch = WindowSampler.of(train), settings, batch
        step = max(1, len(validation.distinct) // 4000)
        self._validation = validation.rotations[validation.distinct[::step]].astype(np.float64)

    def loss(self, step: int, generator: torch.Generator) -> torch.Tensor:
        """Reconstruct the middle and the in-between frame of every window."""
        s = self._settings
        truth = self._sampler.draw(self._batch, generator).rotations[:, [1, 3]].flatten(0, 1)
        self.model.train()
        mean, log_variance = self.model.posterior(truth)
        noise = torch.randn(mean.shape, generator=generator)
        decoded = self.model.decode(mean + torch.exp(0.5 * log_variance) * noise)
        nats = 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(-1)
        penalty = torch.sqrt(1.0 + nats.square()) - 1.0 if s.kind == "rvposer" else nats
        return pose_loss(truth, decoded, torch.ones(len(truth)), s.orthogonality) + s.divergence * penalty.mean()

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return reconstruction figures on the validation poses, from posterior means."""
        vae = cast(VariationalAutoencoder, model)
        vae.eval()
        with torch.no_grad():
            mean, _ = vae.posterior(torch.as_tensor(self._validation, dtype=torch.float32))
            decoded = vae.decode(mean).numpy().astype(np.float64)
        return reconstruction_accuracy(self._validation, decoded).as_dict()
