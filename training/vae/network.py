"""Networks and losses of the variational autoencoders (Pavlakos et al. 2019; thesis 4.2.4, table 6.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import torch
from torch import nn

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.rotations import log_so3, matrix_from_6d
from training.data.corpus import Corpus
from training.data.windows import WindowSampler
from training.engine.accuracy import VALIDATION_POSES, reconstructed, reconstruction_accuracy
from training.engine.devices import device_of
from training.engine.pose_loss import pose_loss
from training.vae.latents import LATENTS, Kind

HIDDEN = 512
"""Width of the layers, as VPoser's (Pavlakos et al. 2019)."""
_DROPOUT = 0.1
"""Share that dropout sets to zero, as VPoser's."""
_INPUTS = 3 * NUM_BODY_JOINTS
"""Numbers of a pose as rotation vectors."""


@dataclass(frozen=True)
class VaeForm:
    """What the autoencoders differ by besides their codes."""

    first_norm: bool = False
    """Batch normalisation before the encoder's first layer."""
    second_norm: bool = False
    """Batch normalisation after the encoder's first activation."""
    decoder_dropout: bool = False
    last_activation: bool = False
    """An activation after the decoder's last layer."""
    charbonnier: bool = False
    """The divergence counts by its Charbonnier penalty (thesis eq. 4.17)."""


FORMS: dict[Kind, VaeForm] = {
    "vposer": VaeForm(first_norm=True, second_norm=True, decoder_dropout=True),
    "vposer_worded": VaeForm(first_norm=True, decoder_dropout=True, last_activation=True),
    "rvposer": VaeForm(charbonnier=True),
    "rvposer_second_norm": VaeForm(second_norm=True, charbonnier=True),
    "svae": VaeForm(),
    "lie_vae": VaeForm(),
}
"""VPoser as its public code has it and as the thesis describes it (4.2.4); RVPoser without any normalisation, and with
the second one, of which the thesis does not speak."""


@dataclass(frozen=True)
class VaeSettings:
    """Which autoencoder, and the losses' weights."""

    kind: Kind
    divergence: float = 1e-3
    """Weight of the Kullback-Leibler divergence (nats), or of its Charbonnier penalty (thesis eq. 4.17)."""
    orthogonality: float = 0.5
    """Weight of the rotations' disagreement (thesis eq. 4.19)."""


class VariationalAutoencoder(nn.Module):
    """63 -> 512 -> 512 -> posterior; code -> 512 -> 512 -> 126."""

    def __init__(self, kind: Kind) -> None:
        super().__init__()
        form = FORMS[kind]
        self.latent = LATENTS[kind]()
        self.norm = nn.BatchNorm1d(_INPUTS) if form.first_norm else nn.Identity()
        self.second_norm = nn.BatchNorm1d(HIDDEN) if form.second_norm else nn.Identity()
        self.encoder = nn.Sequential(
            nn.Linear(_INPUTS, HIDDEN), nn.LeakyReLU(), self.second_norm, nn.Dropout(_DROPOUT),
            nn.Linear(HIDDEN, HIDDEN), nn.LeakyReLU(), nn.Linear(HIDDEN, self.latent.outputs),
        )  # fmt: skip
        self.decoder = nn.Sequential(
            nn.Linear(self.latent.width, HIDDEN), nn.LeakyReLU(),
            nn.Dropout(_DROPOUT if form.decoder_dropout else 0.0), nn.Linear(HIDDEN, HIDDEN), nn.LeakyReLU(),
            nn.Linear(HIDDEN, 6 * NUM_BODY_JOINTS), nn.LeakyReLU() if form.last_activation else nn.Identity(),
        )  # fmt: skip

    def posterior(self, rotations: torch.Tensor) -> torch.Tensor:
        """Return the encoder's outputs for (N, 21, 3, 3) poses."""
        return self.encoder(self.norm(log_so3(rotations).flatten(-2)))

    def encode(self, rotations: torch.Tensor) -> torch.Tensor:
        """Return the codes of (N, 21, 3, 3) poses without noise."""
        return self.latent.mean(self.posterior(rotations))

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """(N, width) -> (N, 21, 3, 3)."""
        return matrix_from_6d(self.decoder(z).unflatten(-1, (NUM_BODY_JOINTS, 6)))


class VaeTask:
    """Losses (thesis eqs. 4.16 to 4.19) and validation."""

    def __init__(self, train: Corpus, validation: Corpus, settings: VaeSettings, batch: int, seed: int) -> None:
        torch.manual_seed(seed)
        self.model = VariationalAutoencoder(settings.kind)
        self._sampler, self._settings, self._batch = WindowSampler.of(train), settings, batch
        self._validation = validation.some_distinct(VALIDATION_POSES).astype(np.float64)

    def draw(self, generator: torch.Generator) -> torch.Tensor:
        """Draw the middle and the in-between frame of windows."""
        return self._sampler.draw(self._batch, generator).rotations[:, [1, 3]].flatten(0, 1)

    def loss(self, batch: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Reconstruct poses."""
        s, truth = self._settings, batch.to(device_of(self.model))
        self.model.train()
        z, nats = self.model.latent.draw(self.model.posterior(truth), generator)
        decoded = self.model.decode(z)
        penalty = torch.sqrt(1.0 + nats.square()) - 1.0 if FORMS[s.kind].charbonnier else nats
        evenly = torch.ones(len(truth), device=truth.device)
        return pose_loss(truth, decoded, evenly, s.orthogonality) + s.divergence * penalty.mean()

    def evaluate(self, model: nn.Module) -> dict[str, float]:
        """Return reconstruction figures on the validation poses, from codes without noise."""
        decoded = reconstructed(cast(VariationalAutoencoder, model), self._validation)
        return reconstruction_accuracy(self._validation, decoded).as_dict()
