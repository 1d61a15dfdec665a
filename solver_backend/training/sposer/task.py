"""SPoser's training: reconstruction on a sphere whose geodesics are motion (thesis 6.1-6.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from torch import nn

from solver_backend.geometry.interpolation import sider2
from solver_backend.geometry.sphere import spherical_normalisation
from solver_backend.training.data.corpus import Corpus
from solver_backend.training.data.points import rotation_points
from solver_backend.training.data.windows import WindowSampler
from solver_backend.training.engine.devices import device_of
from solver_backend.training.sposer.accuracy import reconstruction_accuracy
from solver_backend.training.sposer.network import SphericalAutoencoder


@dataclass(frozen=True)
class SPoserSettings:
    """Network and losses of SPoser."""

    encoder_hidden: tuple[int, ...] = (512, 512)
    decoder_hidden: tuple[int, ...] = (512, 512)
    activation: str = "silu"
    orthogonality: float = 0.05
    """Weight of ``1 - (Tr(R^T R̂) - 1) / 2`` (6.4) next to squared distances of points in dm² (6.3)."""
    between: float = 0.5
    """Weight of the frame between keys against the keys themselves."""
    latent_noise: float = 0.01
    """Standard deviation of each coordinate's noise before decoding."""


class SPoserTask:
    """Losses and validation of SPoser."""

    def __init__(self, train: Corpus, validation: Corpus, settings: SPoserSettings, batch: int, seed: int) -> None:
        torch.manual_seed(seed)
        self.model = SphericalAutoencoder(settings.encoder_hidden, settings.decoder_hidden, settings.activation)
        distinct = torch.as_tensor(train.rotations[train.distinct])
        mean = torch.cat((distinct[..., 0], distinct[..., 1]), dim=-1).mean(dim=0).flatten()
        self.model.start_from(mean)
        self._sampler, self._settings, self._batch = WindowSampler.of(train), settings, batch
        step = max(1, len(validation.distinct) // 4000)
        self._validation = torch.as_tensor(validation.rotations[validation.distinct[::step]])

    def loss(self, step: int, generator: torch.Generator) -> torch.Tensor:
        """Reconstruct middle keys through noisy codes, and frames between through SIDER2 of three codes."""
        s, batch = self._settings, self._sampler.draw(self._batch, generator).to(device_of(self.model))
        codes = self.model.encode(batch.rotations[:, :3].flatten(0, 1)).unflatten(0, (self._batch, 3))
        noise = s.latent_noise * torch.randn(self._batch, codes.shape[-1], generator=generator).to(codes.device)
        between = sider2(codes[:, 0], codes[:, 1], codes[:, 2], batch.time)
        decoded = self.model.decode(torch.cat((spherical_normalisation(codes[:, 1] + noise), between)))
        truth = torch.cat((batch.rotations[:, 1], batch.rotations[:, 3]))
        weight = torch.cat((torch.ones(self._batch), torch.full((self._batch,), s.between))) / (1.0 + s.between)
        return pose_loss(truth, decoded, weight.to(codes.device), s.orthogonality)

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return reconstruction figures on the validation poses."""
        truth = self._validation.numpy().astype(np.float64)
        return reconstruction_accuracy(truth, decode_all(cast(SphericalAutoencoder, model), truth)).as_dict()


def pose_loss(truth: torch.Tensor, decoded: torch.Tensor, weight: torch.Tensor, orthogonality: float) -> torch.Tensor:
    """Return ``mean w (|p - p̂|² + λ Σ(1 - cos angle))`` over (N, 21, 3, 3) poses, distances in dm (6.3, 6.4).

    Points stand for the mesh's vertices: joints, and tips on the axes of every joint's frame.
    """
    distance = (10.0 * (rotation_points(truth) - rotation_points(decoded))).square().sum(-1).mean(-1)
    trace = (truth * decoded).sum((-2, -1))
    misaligned = (1.0 - 0.5 * (trace - 1.0)).mean(-1)
    return 2.0 * (weight * (distance + orthogonality * misaligned)).mean()


def decode_all(model: SphericalAutoencoder, rotations: np.ndarray) -> np.ndarray:
    """Return reconstructions of (N, 21, 3, 3) poses."""
    with torch.no_grad():
        poses = torch.as_tensor(rotations, dtype=torch.float32)
        return model.decode(model.encode(poses)).numpy().astype(np.float64)
