"""Thesis table 6.5: SPoser as in eqs. 6.1 to 6.4, the shipped recipe, and VPoser, trained equally on a CPU.

``plain`` has neither the loss of frames between keys nor the noise of codes. Corpus, augmentation, widths, steps and
batch are equal to ``recipe``'s. All three have 300 steps, while the shipped weights have 6,000 (VPoser 3,000), and none
uses the fitted marker takes. They are measured on 1,052 held-out poses as in `bench autoencoders`. ``alone`` is the
encoder alone, ``step`` adds one Gauss-Newton step (``sposer.nearer_codes``), and ``between`` has frames halfway between
keys 0.2 s apart. Each row is one training, which is too few for a conclusion. Trainings are written to
build/plain_sposer and take three minutes of one core in all. An interrupted training resumes from its checkpoint.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import cast

import numpy as np

from research.priors import load_prior
from solver_backend.priors.gaussian_vae import GaussianVAE
from solver_backend.priors.sposer import SPoser, nearer_codes
from tests.benchmarks.bench_autoencoders import SAMPLES, held_out_poses
from tests.benchmarks.bench_autoencoders import SEEDS as SAMPLING_SEEDS
from tests.benchmarks.comparison.runs import ROOT
from tests.benchmarks.metric import Metric
from tests.benchmarks.pose_priors import prior_tables as tables
from tests.benchmarks.pose_priors.prior_widths import stack, trained
from tests.support.recordings import recordings_folder
from training.data.corpus import Corpus, split_corpus
from training.data.sources.clips import load_clips
from training.engine.accuracy import reconstruction_accuracy
from training.engine.loop import TrainingSettings, run_training
from training.sposer.train import SPoserSettings, between_error_mm
from training.vae.train import VaeSettings, VaeTask, VariationalAutoencoder, folded_encoder

OUT = ROOT / "build" / "plain_sposer"
STEPS, SEED = 300, 0
WIDTHS = (256, 256)  # Widths of the shipped SPoser's decoder.
SPOSERS = {
    "plain": SPoserSettings(decoder_hidden=WIDTHS, between=0.0, latent_noise=0.0),
    "recipe": SPoserSettings(decoder_hidden=WIDTHS),
}
SPACING = 6  # Frames between keys.


def run() -> list[Metric]:
    """Train missing rows, and measure."""
    return [
        Metric(f"{row}_{key}", value, "mm" if key.endswith("_mm") else "")
        for row in ("plain", "recipe", "vposer")
        for key, value in figures(prior_of(row)).items()
    ]


@cache
def corpora() -> tuple[Corpus, Corpus]:
    """Return the poses to train on and the poses of held-out subjects."""
    return split_corpus(load_clips(recordings_folder(), fitted=False))


def prior_of(row: str) -> SPoser | GaussianVAE:
    """Return a training, made now or before."""
    training, validation = corpora()
    folder = OUT / f"{row}_{SEED}"
    if row in SPOSERS:
        return trained(training, validation, SPOSERS[row], SEED, folder, STEPS)
    return _vposer(training, validation, folder)


def _vposer(training: Corpus, validation: Corpus, folder: Path) -> GaussianVAE:
    run = TrainingSettings(steps=STEPS, seed=SEED, evaluate_every=STEPS)
    task = VaeTask(training, validation, VaeSettings("vposer"), run.batch, SEED)
    model = cast(VariationalAutoencoder, run_training(task, run, folder))
    encoder, decoder = (stack(part, "leaky_relu") for part in (folded_encoder(model), model.decoder))
    return GaussianVAE(encoder, decoder, np.ones((21, 3)), {"prior": "vposer"})


def figures(prior: SPoser | GaussianVAE) -> dict[str, float]:
    """Return the errors of a prior's reconstructions and samples."""
    poses, yardstick = held_out_poses(), load_prior("vposer")
    if isinstance(prior, SPoser):
        alone, stepped = prior.guess(poses), prior.encode(poses)
    else:
        alone = prior.encode(poses)
        stepped = nearer_codes(prior.decode_with_jacobian, poses, alone)
    real = np.asarray(yardstick.encode(poses))
    drawn = [tables.code_synthesis(np.asarray(prior.sample(SAMPLES, s)), real, yardstick, s) for s in SAMPLING_SEEDS]
    found = {
        "alone_mpjpe_mm": reconstruction_accuracy(poses, prior.decode(alone)).mpjpe_mm,
        "step_mpjpe_mm": reconstruction_accuracy(poses, prior.decode(stepped)).mpjpe_mm,
        "fid_codes": float(np.median([d["FID codes"] for d in drawn])),
        "div_codes": float(np.median([d["DIV codes"] for d in drawn])),
    }
    if isinstance(prior, SPoser):
        found["between_mpjpe_mm"] = between_error_mm(prior, corpora()[1], SPACING)
    return found
