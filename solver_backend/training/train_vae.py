"""VPoser and RVPoser from corpus to weights."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Literal, cast

import numpy as np
import torch
from torch import nn

from solver_backend.priors.gaussian_vae import load_vae
from solver_backend.training.accuracy import reconstruction_accuracy
from solver_backend.training.export import export_prior, stack_arrays
from solver_backend.training.loop import run_training
from solver_backend.training.model_card import write_model_card
from solver_backend.training.recipe import Finished, Job
from solver_backend.training.spherical_autoencoder import linear_layers
from solver_backend.training.variational_autoencoder import HIDDEN, VaeSettings, VaeTask, VariationalAutoencoder

_SUMMARIES = {
    "vposer": """VPoser (Pavlakos et al. 2019): a variational autoencoder of the 21 body joints' rotations with a
standard normal code of 32 dimensions, batch normalisation, dropout and a leaky last layer; retrained on our corpus.""",
    "rvposer": """RVPoser (thesis 4.2.4): VPoser without batch normalisation, decoder dropout and last activation, its
divergence under a Charbonnier penalty (4.16-4.19).""",
}
_TITLES = {"vposer": "VPoser", "rvposer": "RVPoser"}


def train_vposer(job: Job) -> Finished:
    """Train and export VPoser."""
    return _train(job, VaeSettings("vposer"))


def train_rvposer(job: Job) -> Finished:
    """Train and export RVPoser."""
    return _train(job, VaeSettings("rvposer"))


def _train(job: Job, settings: VaeSettings) -> Finished:
    task = VaeTask(job.training, job.validation, settings, job.settings.batch, job.settings.seed)
    model = cast(VariationalAutoencoder, run_training(task, job.settings, job.work, job.progress))
    return export_vae(model, job, settings)


def export_vae(model: VariationalAutoencoder, job: Job, settings: VaeSettings) -> Finished:
    """Write weights and model card of a trained network."""
    kind: Literal["vposer", "rvposer"] = settings.kind
    path = job.out / f"{kind}.npz"
    arrays = stack_arrays(folded_encoder(model), "encoder") | stack_arrays(model.decoder, "decoder")
    metadata: dict[str, Any] = {
        "encoder_hidden": (HIDDEN, HIDDEN),
        "decoder_hidden": (HIDDEN, HIDDEN),
        "activation": "leaky_relu",
        "activate_last": kind == "vposer",
        "command": job.command,
        "settings": asdict(settings) | asdict(job.settings),
        "data": job.data,
    }
    export_prior(path, kind, arrays, metadata)
    truth = job.validation.rotations[job.validation.distinct].astype(np.float64)
    shipped = load_vae(kind, path)
    metadata["metrics"] = reconstruction_accuracy(truth, shipped.decode(shipped.encode(truth))).as_dict()
    metadata["sha256"] = export_prior(path, kind, arrays, metadata)
    write_model_card(path.with_suffix(".md"), _TITLES[kind], _SUMMARIES[kind], metadata)
    return Finished(path, metadata["metrics"])


def folded_encoder(model: VariationalAutoencoder) -> nn.Sequential:
    """Return the encoder with the batch normalisation's scale and shift taken into the first layer."""
    layers = linear_layers(model.encoder)
    if not isinstance(model.norm, nn.BatchNorm1d):
        return nn.Sequential(*layers)
    norm, first = model.norm, layers[0]
    mean, variance = cast(torch.Tensor, norm.running_mean), cast(torch.Tensor, norm.running_var)
    scale = norm.weight / torch.sqrt(variance + norm.eps)
    folded = nn.Linear(first.in_features, first.out_features)
    with torch.no_grad():
        folded.weight.copy_(first.weight * scale)
        folded.bias.copy_(first.bias + first.weight @ (norm.bias - mean * scale))
    return nn.Sequential(folded, *layers[1:])
