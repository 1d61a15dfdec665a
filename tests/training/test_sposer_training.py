"""SPoser's and the variational autoencoders' losses, and what is exported against what was trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import silent
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.catalogue import load_prior
from solver_backend.priors.sposer import load_sposer
from solver_backend.training.data.corpus import Corpus, build_corpus
from solver_backend.training.data.sources.clips import Clip
from solver_backend.training.engine.loop import TrainingSettings
from solver_backend.training.engine.recipe import Job
from solver_backend.training.sposer.accuracy import reconstruction_accuracy, reconstruction_statistics
from solver_backend.training.sposer.network import linear_layers
from solver_backend.training.sposer.task import SPoserSettings, pose_loss
from solver_backend.training.sposer.train import train_sposer
from solver_backend.training.train import train
from solver_backend.training.vae.latents import Kind
from solver_backend.training.vae.network import VariationalAutoencoder
from solver_backend.training.vae.train import folded_encoder, train_vae

DATA = {
    "sources": {"training/sway": {"clips": 1, "frames": 40, "distinct": 40}}, "keyed_repeats": 4,
    "near_repeat_mm": 12.0, "held_out": "08",
}  # fmt: skip


def swaying(seed: int, frames: int = 40) -> Corpus:
    rng = np.random.default_rng(seed)
    phase, amplitude = rng.uniform(0, 6, (21, 3)), 0.3 * rng.standard_normal((21, 3))
    time = np.arange(frames)[:, None, None] / 30.0
    return build_corpus([Clip("sway", "02", exp_so3(amplitude * np.sin(4 * time + phase)).astype(np.float32))])


def job(folder: Path, steps: int) -> Job:
    settings = TrainingSettings(steps=steps, batch=16, evaluate_every=steps)
    return Job(swaying(0), swaying(0), settings, folder, folder / "run", "train", DATA, silent)


def test_loss_is_zero_at_the_truth_and_counts_distance() -> None:
    R = torch.as_tensor(exp_so3(0.3 * np.random.default_rng(0).standard_normal((3, 21, 3))))
    one = torch.ones(3, dtype=R.dtype)
    assert float(pose_loss(R, R, one, 0.5)) == pytest.approx(0.0, abs=1e-12)
    turned = R.clone()
    turned[:, 20] = R[:, 20] @ torch.as_tensor(exp_so3(np.array([0.0, 0.0, 0.2])))
    small = pose_loss(R, turned, one, 0.0)
    assert float(small) > 0
    assert float(pose_loss(R, turned, one, 1.0) - small) == pytest.approx(2 * (1 - np.cos(0.2)) / 21, rel=1e-9)
    assert float(pose_loss(R, turned, 2 * one, 0.0)) == pytest.approx(2 * float(small))


def test_sposer_learns_and_exports_what_it_learned(tmp_path: Path) -> None:
    settings = SPoserSettings(encoder_hidden=(64,), decoder_hidden=(64, 48))
    finished = train_sposer(job(tmp_path, 250), settings)
    prior = load_sposer(finished.weights)
    assert prior.widths == ((126, 64, 32), (32, 64, 48, 126))
    assert finished.metrics["mpjpe_mm"] < 25.0
    truth = swaying(0).rotations[::3].astype(np.float64)
    assert reconstruction_accuracy(truth, prior.decode(prior.encode(truth))).mpjpe_mm < 25.0
    assert prior.metadata["sha256"] in finished.weights.with_suffix(".md").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", ["vposer", "rvposer", "svae", "lie_vae"])
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


def test_statistics_find_the_spread() -> None:
    rng = np.random.default_rng(0)
    decoded = exp_so3(0.5 * rng.standard_normal((4000, 21, 3)))
    sigma = np.radians(rng.uniform(1, 8, (21, 3)))
    truth = exp_so3(sigma * rng.standard_normal((4000, 21, 3))) @ decoded
    np.testing.assert_allclose(reconstruction_statistics(truth, decoded), sigma, rtol=0.08)


def test_unknown_prior_is_named(tmp_path: Path) -> None:
    with pytest.raises(JobInvalid, match=r"no prior 'poser' \(known: .*sposer"):
        train("poser", tmp_path, tmp_path)


def test_folded_encoder_is_the_trained_one() -> None:
    torch.manual_seed(0)
    model = VariationalAutoencoder("vposer")
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
