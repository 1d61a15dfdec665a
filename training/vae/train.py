"""The variational autoencoders from corpus to weights."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import nn

from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.catalogue import load_prior
from training.engine.accuracy import accuracy_by_source, autoencoder_arrays, reconstruction_accuracy
from training.engine.dense_layers import linear_layers
from training.engine.loop import run_training
from training.engine.model_card import Card
from training.engine.publish import Figures, publish
from training.engine.recipe import Finished, TrainingJob
from training.vae.latents import Kind
from training.vae.network import (
    FORMS,
    HIDDEN,
    VaeSettings,
    VaeTask,
    VariationalAutoencoder,
)

_SUMMARIES: dict[Kind, str] = {
    "vposer": """VPoser (Pavlakos et al. 2019) as its public code has it: a variational autoencoder of the 21 body
joints' rotations with a standard normal code of 32 dimensions, batch normalisation before the encoder's first and
second layer and dropout in the decoder; retrained on our corpus.""",
    "vposer_worded": """VPoser as the thesis describes it (4.2.4): batch normalisation before the first layer alone, and
an activation after the decoder's last, which the public code does not have; retrained on our corpus.""",
    "rvposer": """RVPoser (thesis 4.2.4): VPoser without batch normalisation, decoder dropout and last activation, its
divergence under a Charbonnier penalty (4.16-4.19).""",
    "rvposer_second_norm": """RVPoser (thesis 4.2.4) read to the letter: of the public code's two batch normalisations
only the first is removed; its divergence under a Charbonnier penalty (4.16-4.19).""",
    "svae": """SVAE (Davidson et al. 2018; thesis table 6.5): a variational autoencoder of the 21 body joints' rotations
whose codes are unit vectors in R^32, von Mises-Fisher about each pose's direction and uniform over all of them. Layers
as RVPoser's.""",
    "lie_vae": """LieVAE (Falorsi et al. 2018; thesis table 6.5): a variational autoencoder of the 21 body joints'
rotations whose codes are ten rotations, normal in the tangent space of each pose's and uniform on the group over all.
Layers as RVPoser's.""",
}
_TITLES: dict[Kind, str] = {
    "vposer": "VPoser", "vposer_worded": "VPoser as worded", "rvposer": "RVPoser",
    "rvposer_second_norm": "RVPoser with the second normalisation", "svae": "SVAE", "lie_vae": "LieVAE",
}  # fmt: skip


def train_vae(kind: Kind, job: TrainingJob) -> Finished:
    """Train and export one of the variational autoencoders."""
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
    """Return the encoder with each batch normalisation's scale and shift taken into the layer after it."""
    first, *rest = linear_layers(model.encoder)
    return nn.Sequential(_folded(model.norm, first), _folded(model.second_norm, rest[0]), *rest[1:])


def _folded(norm: nn.Module, layer: nn.Linear) -> nn.Linear:
    """Return a layer that takes what the normalisation before it took: ``W ((x - m) s + b) + c``."""
    if not isinstance(norm, nn.BatchNorm1d):
        return layer
    mean, variance = cast(torch.Tensor, norm.running_mean), cast(torch.Tensor, norm.running_var)
    scale = norm.weight / torch.sqrt(variance + norm.eps)
    folded = nn.Linear(layer.in_features, layer.out_features)
    with torch.no_grad():
        folded.weight.copy_(layer.weight * scale)
        folded.bias.copy_(layer.bias + layer.weight @ (norm.bias - mean * scale))
    return folded
