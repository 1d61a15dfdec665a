"""The variational autoencoders from corpus to weights."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, cast

import numpy as np
import torch
from torch import nn

from solver_backend.priors.base import PosePrior
from solver_backend.priors.catalogue import load_prior
from solver_backend.training.engine.export_weights import export_prior, stack_arrays
from solver_backend.training.engine.loop import run_training
from solver_backend.training.engine.model_card import write_model_card
from solver_backend.training.engine.recipe import Finished, Job
from solver_backend.training.sposer.accuracy import (
    accuracy_by_source,
    reconstruction_accuracy,
    reconstruction_statistics,
)
from solver_backend.training.sposer.network import linear_layers
from solver_backend.training.vae.latents import Kind
from solver_backend.training.vae.network import (
    HIDDEN,
    VaeSettings,
    VaeTask,
    VariationalAutoencoder,
    decode_all,
)

_SUMMARIES: dict[Kind, str] = {
    "vposer": """VPoser (Pavlakos et al. 2019): a variational autoencoder of the 21 body joints' rotations with a
standard normal code of 32 dimensions, batch normalisation, dropout and a leaky last layer; retrained on our corpus.""",
    "rvposer": """RVPoser (thesis 4.2.4): VPoser without batch normalisation, decoder dropout and last activation, its
divergence under a Charbonnier penalty (4.16-4.19).""",
    "svae": """SVAE (Davidson et al. 2018; thesis table 6.5): a variational autoencoder of the 21 body joints' rotations
whose codes are unit vectors in R^32, von Mises-Fisher about each pose's direction and uniform over all of them. Layers
as RVPoser's.""",
    "lie_vae": """LieVAE (Falorsi et al. 2018; thesis table 6.5): a variational autoencoder of the 21 body joints'
rotations whose codes are ten rotations, normal in the tangent space of each pose's and uniform on the group over all.
Layers as RVPoser's.""",
}
_TITLES: dict[Kind, str] = {"vposer": "VPoser", "rvposer": "RVPoser", "svae": "SVAE", "lie_vae": "LieVAE"}


def train_vae(kind: Kind, job: Job) -> Finished:
    """Train and export one of the variational autoencoders."""
    settings = VaeSettings(kind)
    task = VaeTask(job.training, job.validation, settings, job.settings.batch, job.settings.seed)
    model = cast(VariationalAutoencoder, run_training(task, job.settings, job.work, job.progress))
    return export_vae(model, job, settings)


def export_vae(model: VariationalAutoencoder, job: Job, settings: VaeSettings) -> Finished:
    """Write weights and model card of a trained network."""
    kind = settings.kind
    path = job.out / f"{kind}.npz"
    truth = job.validation.rotations[job.validation.distinct].astype(np.float64)
    arrays = stack_arrays(folded_encoder(model), "encoder") | stack_arrays(model.decoder, "decoder")
    arrays["residual_sigma"] = reconstruction_statistics(truth, decode_all(model, truth)).astype(np.float32)
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
    shipped = load_prior(kind, path)
    metadata["metrics"] = reconstruction_accuracy(truth, _reconstructed(shipped, truth)).as_dict()
    metadata["by_source"] = accuracy_by_source(job.validation, lambda R: _reconstructed(shipped, R))
    metadata["sha256"] = export_prior(path, kind, arrays, metadata)
    write_model_card(path.with_suffix(".md"), _TITLES[kind], _SUMMARIES[kind], metadata)
    return Finished(path, metadata["metrics"])


def _reconstructed(prior: PosePrior, rotations: np.ndarray) -> np.ndarray:
    return prior.decode(prior.encode(rotations))


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
