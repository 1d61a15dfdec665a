"""Width of SPoser's decoder: accuracy after short, equal trainings, and the time for its Jacobian."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np
import torch
from torch import nn

from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.priors.autoencoder import DenseStack
from solver_backend.priors.sposer import SPoser
from tests.benchmarks.pose_priors.prior_tables import Table
from training.data.corpus import Corpus
from training.engine.accuracy import reconstruction_accuracy
from training.engine.dense_layers import linear_layers
from training.engine.loop import TrainingSettings, run_training
from training.sposer.train import SphericalAutoencoder, SPoserSettings, SPoserTask

WIDTHS, SEEDS, STEPS = (128, 256, 512), (0, 1, 2), 1000
DECODED, REPEATS = 2000, 3


def width_table(training: Corpus, validation: Corpus, truth: np.ndarray, folder: Path) -> Table:
    """Return the medians of three seeds for every width. Trainings in ``folder`` are continued.

    Args:
        training: corpus for training.
        validation: corpus for a training's reports.
        truth: (N, 21, 3, 3) validation poses for the measurement.
        folder: folder of the checkpoints.
    """
    rows: Table = {}
    for width in WIDTHS:
        settings = SPoserSettings(decoder_hidden=(width, width))
        priors = [trained(training, validation, settings, seed, folder / f"{width}_{seed}") for seed in SEEDS]
        found = [reconstruction_accuracy(truth, p.decode(p.encode(truth))) for p in priors]
        median = {name: float(np.median([f.as_dict()[name] for f in found])) for name in found[0].as_dict()}
        rows[f"H = {width}"] = {
            "epochs": STEPS * TrainingSettings().batch / len(training.distinct), "MPJPE mm": median["mpjpe_mm"],
            "worst 5 % mm": median["worst5_mpjpe_mm"], "PCK3 %": median["pck3_percent"],
            "angle °": median["angle_deg"], **jacobian_times(priors[0]),
        }  # fmt: skip
    return rows


def jacobian_times(prior: SPoser) -> dict[str, float]:
    """Return the processor seconds for rotations and Jacobians of 2,000 poses on one thread, as minimum of three."""
    codes = spherical_normalisation(np.random.default_rng(0).standard_normal((DECODED, prior.latent_dim)))
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    kinds = {
        "NumPy s": codes, "torch s": torch.as_tensor(codes), "NumPy single s": codes.astype(np.float32),
        "torch single s": torch.as_tensor(codes, dtype=torch.float32),
    }  # fmt: skip
    times = {name: min(_seconds(lambda z=z: prior.decode_with_jacobian(z)) for _ in range(REPEATS))
             for name, z in kinds.items()}  # fmt: skip
    torch.set_num_threads(threads)
    return times


def _seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def trained(
    training: Corpus, validation: Corpus, settings: SPoserSettings, seed: int, folder: Path, steps: int = STEPS
) -> SPoser:
    """Return SPoser after a short training, from ``folder`` if it is complete there."""
    run = TrainingSettings(steps=steps, seed=seed, evaluate_every=steps)
    task = SPoserTask(training, validation, settings, run.batch, seed)
    model = cast(SphericalAutoencoder, run_training(task, run, folder))
    encoder, decoder = (stack(part, settings.activation) for part in (model.encoder, model.decoder))
    return SPoser(encoder, decoder, np.ones((21, 3)), {})


def stack(layers: nn.Sequential, activation: str) -> DenseStack:
    """Return the layers of a network in the solver's format."""
    linear = linear_layers(layers)
    weights, biases = (tuple(a.detach().numpy().astype(np.float64) for a in arrays)
                       for arrays in zip(*((x.weight, x.bias) for x in linear), strict=True))  # fmt: skip
    return DenseStack(weights, biases, activation)
