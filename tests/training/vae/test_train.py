"""The variational autoencoders' training, and what is exported against what was trained."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
from torch import nn

from research.priors import load_prior
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.base import AutoencodingPrior
from tests.support.swaying_corpus import job, swaying
from training.engine.accuracy import reconstruction_accuracy
from training.engine.dense_layers import linear_layers
from training.vae.train import Kind, VariationalAutoencoder, folded_encoder, train_vae


@pytest.mark.parametrize("kind", get_args(Kind))
def test_vae_exports_what_it_learned(tmp_path: Path, kind: Kind) -> None:
    finished = train_vae(kind, job(tmp_path, 60))
    prior = load_prior(kind, finished.weights)
    assert isinstance(prior, AutoencodingPrior)
    truth = swaying(0).rotations[::4].astype(np.float64)
    z = prior.encode(truth)
    R, J = prior.decode_with_jacobian(z)
    assert J.shape == (len(truth), 21, 3, prior.latent_dim)
    np.testing.assert_allclose(R, prior.decode(z), atol=1e-12)

    distinct = swaying(0).rotations[swaying(0).distinct].astype(np.float64)
    whole = reconstruction_accuracy(distinct, prior.decode(prior.encode(distinct)))
    assert finished.metrics["mpjpe_mm"] == pytest.approx(whole.mpjpe_mm)
    card = finished.weights.with_suffix(".md").read_text(encoding="utf-8")
    assert "| sway |" in card and str(prior.metadata["sha256"]) in card


@pytest.mark.parametrize("kind", ["vposer", "vposer_worded", "rvposer_second_norm"])
def test_folded_encoder_is_the_trained_one(kind: Kind) -> None:
    torch.manual_seed(0)
    model = VariationalAutoencoder(kind)
    poses = torch.as_tensor(swaying(1).rotations)
    model.train()
    for _ in range(20):
        model.encode(poses)
    model.eval()
    mean = model.encode(poses)
    first, second, third = linear_layers(folded_encoder(model))
    hidden = nn.functional.leaky_relu(first(log_so3(poses).flatten(-2)))
    folded = third(nn.functional.leaky_relu(second(hidden)))[:, :32]
    np.testing.assert_allclose(folded.detach().numpy(), mean.detach().numpy(), atol=1e-4)
