"""SPoser's training: reconstruction on a sphere whose geodesics are motion (thesis eqs. 6.1 to 6.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from torch import nn

from solver_backend.geometry.interpolation import sider2
from solver_backend.geometry.sphere import spherical_normalisation
from training.data.corpus import Corpus
from training.data.windows import WindowSampler
from training.engine.accuracy import VALIDATION_POSES, reconstructed, reconstruction_accuracy
from training.engine.devices import device_of
from training.engine.pose_loss import pose_loss
from training.sposer.network import SphericalAutoencoder


@dataclass(frozen=True)
class SPoserSettings:
    """Network and losses of SPoser."""

    encoder_hidden: tuple[int, ...] = (512, 512)
    decoder_hidden: tuple[int, ...] = (512, 512)
    activation: str = "silu"
    orthogonality: float = 0.05
    """Weight of ``1 - (Tr(R^T R̂) - 1) / 2`` next to squared distances of points in dm² (thesis eqs. 6.4, 6.3)."""
    between: float = 0.5
    """Weight of the frame between keys against the keys themselves."""
    latent_noise: float = 0.01
    """Standard deviation of each coordinate's noise before decoding."""
    turned_chance: float = 0.35
    """Share of the windows with limbs turned anywhere within anatomical limits."""
    end_chance: float = 0.3
    """Share of the windows with ankles, toes and wrists moved towards their ends."""


class SPoserTask:
    """Losses and validation of SPoser, on held-out subjects and, where there are any, on motions unlike the corpus."""

    def __init__(
        self, train: Corpus, validation: Corpus, settings: SPoserSettings, batch: int, seed: int,
        far: Corpus | None = None,
    ) -> None:  # fmt: skip
        torch.manual_seed(seed)
        self.model = SphericalAutoencoder(settings.encoder_hidden, settings.decoder_hidden, settings.activation)
        distinct = torch.as_tensor(train.rotations[train.distinct])
        mean = torch.cat((distinct[..., 0], distinct[..., 1]), dim=-1).mean(dim=0).flatten()
        self.model.start_from(mean)
        chances = {"turned_chance": settings.turned_chance, "end_chance": settings.end_chance}
        self._sampler, self._settings, self._batch = WindowSampler.of(train, **chances), settings, batch
        self._unseen = {"": validation} | ({} if far is None else {"far_": far})

    def draw(self, generator: torch.Generator) -> Any:
        """Draw windows."""
        return self._sampler.draw(self._batch, generator)

    def loss(self, batch: Any, generator: torch.Generator) -> torch.Tensor:
        """Reconstruct middle keys through noisy codes, and frames between through SIDER2 of three codes."""
        s, batch = self._settings, batch.to(device_of(self.model))
        codes = self.model.encode(batch.rotations[:, :3].flatten(0, 1)).unflatten(0, (self._batch, 3))
        noise = s.latent_noise * torch.randn(self._batch, codes.shape[-1], generator=generator).to(codes.device)
        between = sider2(codes[:, 0], codes[:, 1], codes[:, 2], batch.time)
        decoded = self.model.decode(torch.cat((spherical_normalisation(codes[:, 1] + noise), between)))
        truth = torch.cat((batch.rotations[:, 1], batch.rotations[:, 3]))
        weight = torch.cat((torch.ones(self._batch), torch.full((self._batch,), s.between))) / (1.0 + s.between)
        return pose_loss(truth, decoded, weight.to(codes.device), s.orthogonality)

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return reconstruction figures on the validation poses."""
        figures = {}
        for prefix, corpus in self._unseen.items():
            truth = corpus.some_distinct(VALIDATION_POSES).astype(np.float64)
            found = reconstruction_accuracy(truth, reconstructed(cast(SphericalAutoencoder, model), truth))
            figures |= {f"{prefix}{name}": value for name, value in found.as_dict().items()}
        return figures


class EncoderTask(SPoserTask):
    """The encoder alone, for a decoder that stays as it is: codes of poses whose decoded poses come nearest to them.

    A decoder reaches further than the encoder that was trained with it finds.
    """

    def __init__(
        self, train: Corpus, validation: Corpus, settings: SPoserSettings, batch: int, seed: int,
        far: Corpus | None = None,
    ) -> None:  # fmt: skip
        super().__init__(train, validation, settings, batch, seed, far)
        self.model.decoder.requires_grad_(False)

    def draw(self, generator: torch.Generator) -> Any:
        """Draw poses."""
        return self._sampler.draw_poses(self._batch, generator)

    def loss(self, batch: Any, generator: torch.Generator) -> torch.Tensor:
        """Reconstruct poses."""
        truth = batch.to(device_of(self.model))
        decoded = self.model.decode(self.model.encode(truth))
        return pose_loss(truth, decoded, truth.new_ones(self._batch), self._settings.orthogonality)
