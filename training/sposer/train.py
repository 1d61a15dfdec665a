"""Train SPoser, from the corpus to the shipped weights."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import nn

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.interpolation import sider2, spherical_normalisation
from solver_backend.geometry.rotations import matrix_from_6d, matrix_to_6d
from solver_backend.priors.sposer import LATENT_DIM, SPoser, load_sposer
from solver_backend.priors.weights import read_stack, read_weights
from training.data.corpus import LIMB_SPREAD, Corpus, WindowSampler
from training.data.sources.clips import FPS
from training.engine.accuracy import (
    VALIDATION_POSES,
    accuracy_by_source,
    autoencoder_arrays,
    joint_distances,
    pose_loss,
    reconstructed,
    reconstruction_accuracy,
)
from training.engine.dense_layers import dense_stack, linear_layers, take_over
from training.engine.loop import device_of, run_training
from training.engine.publish import Card, Figures, Finished, TrainingJob, publish


class SphericalAutoencoder(nn.Module):
    """Autoencoder between poses and zero-mean codes of unit length."""

    def __init__(self, encoder_hidden: tuple[int, ...], decoder_hidden: tuple[int, ...], activation: str) -> None:
        super().__init__()
        self.encoder = dense_stack((126, *encoder_hidden, LATENT_DIM), activation)
        self.decoder = dense_stack((LATENT_DIM, *decoder_hidden, 126), activation)

    def start_from(self, mean_6d: torch.Tensor) -> None:
        """Centre the encoder's input and the decoder's output on the mean pose, and scale weights for unit codes."""
        with torch.no_grad():
            first, last = linear_layers(self.encoder)[0], linear_layers(self.decoder)[-1]
            first.weight.mul_(3.0)
            first.bias.sub_(first.weight @ mean_6d)
            linear_layers(self.decoder)[0].weight.mul_(LATENT_DIM**0.5)
            last.weight.mul_(0.5)
            last.bias.copy_(mean_6d)

    def encode(self, rotations: torch.Tensor) -> torch.Tensor:
        """Encode poses (N, 21, 3, 3) to codes (N, 32)."""
        return spherical_normalisation(self.encoder(matrix_to_6d(rotations).flatten(-2)))

    def decode(self, z: torch.Tensor) -> torch.Tensor:
        """Decode codes (N, 32) to poses (N, 21, 3, 3)."""
        return matrix_from_6d(self.decoder(z).unflatten(-1, (NUM_BODY_JOINTS, 6)))


@dataclass(frozen=True)
class SPoserSettings:
    """Settings of SPoser's network, losses and data."""

    encoder_hidden: tuple[int, ...] = (512, 512)
    decoder_hidden: tuple[int, ...] = (512, 512)
    activation: str = "silu"
    orthogonality: float = 0.05
    """Weight of ``1 - (Tr(R^T R̂) - 1) / 2`` relative to squared point distances in dm² (thesis eqs. 6.4, 6.3)."""
    between: float = 0.5  # Weight of the frame between keys, relative to the keys.
    latent_noise: float = 0.01  # Standard deviation of the noise on each coordinate before decoding.
    turned_chance: float = 0.35  # Fraction of windows with limbs rotated randomly within anatomical limits.
    end_chance: float = 0.3  # Fraction of windows with ankles, toes and wrists rotated towards their limits.


class SPoserTask:
    """Losses of SPoser, and validation on held-out subjects and, if available, on motions unlike the corpus."""

    def __init__(
        self,
        train: Corpus,
        validation: Corpus,
        settings: SPoserSettings,
        batch: int,
        seed: int,
        far: Corpus | None = None,
    ) -> None:
        torch.manual_seed(seed)
        self.model = SphericalAutoencoder(settings.encoder_hidden, settings.decoder_hidden, settings.activation)
        distinct = torch.as_tensor(train.rotations[train.distinct])
        mean = torch.cat((distinct[..., 0], distinct[..., 1]), dim=-1).mean(dim=0).flatten()
        self.model.start_from(mean)
        chances = {"turned_chance": settings.turned_chance, "end_chance": settings.end_chance}
        self._sampler, self._settings, self._batch = WindowSampler.of(train, **chances), settings, batch
        self._unseen = {"": validation} | ({} if far is None else {"far_": far})

    def draw(self, generator: torch.Generator) -> Any:
        """Draw a batch of augmented windows."""
        return self._sampler.draw(self._batch, generator)

    def loss(self, batch: Any, generator: torch.Generator) -> torch.Tensor:
        """Return the loss of middle keys decoded from noisy codes, and of frames interpolated by SIDER2."""
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
    """Trains only the encoder, for a fixed decoder. The encoder learns the codes that decode nearest to the input.

    A decoder can represent poses that the encoder trained with it does not find.
    """

    def __init__(
        self,
        train: Corpus,
        validation: Corpus,
        settings: SPoserSettings,
        batch: int,
        seed: int,
        far: Corpus | None = None,
    ) -> None:
        super().__init__(train, validation, settings, batch, seed, far)
        self.model.decoder.requires_grad_(False)

    def draw(self, generator: torch.Generator) -> Any:
        """Draw a batch of augmented poses."""
        return self._sampler.draw_poses(self._batch, generator)

    def loss(self, batch: Any, generator: torch.Generator) -> torch.Tensor:
        """Return the reconstruction loss of a batch of poses."""
        truth = batch.to(device_of(self.model))
        decoded = self.model.decode(self.model.encode(truth))
        return pose_loss(truth, decoded, truth.new_ones(self._batch), self._settings.orthogonality)


_ENCODER_ALONE = """ The encoder was trained alone for the decoder of `--from`. The decoder's weights are unchanged."""
CARD = Card(
    "SPoser",
    """SPoser (thesis 6.2.2) is an autoencoder of the 21 body joints' rotations. Its codes are unit vectors of zero mean
in R^32. It is trained to reconstruct poses (6.3 and 6.4, with joints and the axis tips of every joint's frame as
points). It also learns to reconstruct the frame between keys up to 0.3 s apart from SIDER2 of the keys' codes, as in
the solver.""",
)


def train_sposer(job: TrainingJob, settings: SPoserSettings | None = None) -> Finished:
    """Train SPoser, export its weights, measure them and write the model card."""
    settings = settings or SPoserSettings(decoder_hidden=(job.hidden, job.hidden))
    kind = EncoderTask if job.settings.part == "encoder" else SPoserTask
    task = kind(job.training, job.validation, settings, job.settings.batch, job.settings.seed, job.far)
    if job.start is not None:
        start, pose = read_weights(job.start, "sposer"), 6 * NUM_BODY_JOINTS
        take_over(task.model.encoder, read_stack(start, "encoder", pose, LATENT_DIM))
        take_over(task.model.decoder, read_stack(start, "decoder", LATENT_DIM, pose))
    model = cast(SphericalAutoencoder, run_training(task, job.settings, job.work, job.progress))
    truth = job.validation.rotations[job.validation.distinct].astype(np.float64)
    arrays = autoencoder_arrays(model, model.encoder, model.decoder, truth)
    header = {name: getattr(settings, name) for name in ("encoder_hidden", "decoder_hidden", "activation")}
    asked = asdict(settings) | asdict(job.settings)

    def measured(path: Path) -> Figures:
        prior = load_sposer(path)
        unseen = [corpus for corpus in (job.validation, job.far) if corpus is not None]
        by_source = {k: v for corpus in unseen for k, v in accuracy_by_source(corpus, prior.reconstruct).items()}
        return {"metrics": measure(prior, truth, job.validation), "by_source": by_source}

    return publish(job, "sposer", arrays, header, asked, measured, _card(settings, job.settings.part))


def _card(settings: SPoserSettings, part: str) -> Card:
    more = (
        f" In {100 * settings.turned_chance:.0f} % limbs, spine or head turned as a whole by a normal draw of "
        f"{100 * LIMB_SPREAD[0]:.0f} to {100 * LIMB_SPREAD[1]:.0f} % of each joint's\nranges, within its limits; in "
        f"{100 * settings.end_chance:.0f} % ankles, toes and wrists moved anywhere up to one of their ends."
    )
    return replace(CARD, summary=CARD.summary + _ENCODER_ALONE * (part == "encoder"), augmentation=more)


def measure(prior: SPoser, truth: np.ndarray, validation: Corpus) -> dict[str, float]:
    """Return reconstruction figures, and the error of frames between keys that are 0.1, 0.2 and 0.3 s apart."""
    figures = reconstruction_accuracy(truth, prior.reconstruct(truth)).as_dict()
    for spacing in (3, 6, 9):
        error = between_error_mm(prior, validation, spacing)
        figures[f"between_keys_{spacing / FPS:.1f}s_mpjpe_mm"] = error
    return figures


def between_error_mm(prior: SPoser, corpus: Corpus, spacing: int, most: int = 4000) -> float:
    """Return the mean joint error in millimetres of frames halfway between keys, using SIDER2 on three keys' codes.

    Args:
        prior: prior that encodes the keys and decodes the frame.
        corpus: motions.
        spacing: frames between neighbouring keys.
        most: largest number of windows.
    """
    middle = np.arange(corpus.num_frames)
    fits = (middle - spacing >= corpus.clip_start) & (middle + spacing < corpus.clip_end)
    middle = middle[fits][:: max(1, int(fits.sum()) // most)]
    early = spacing // 2
    a, b, c = (prior.encode(corpus.rotations[middle + k].astype(np.float64)) for k in (-spacing, 0, spacing))
    decoded = prior.decode(sider2(a, b, c, 0.5 * (spacing - early) / spacing))
    truth = corpus.rotations[middle - early].astype(np.float64)
    return 1000 * float(joint_distances(truth, decoded).mean())
