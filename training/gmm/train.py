"""The Gaussian mixture from corpus to weights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.rest_skeleton import BODY_MIRROR
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.gmm import load_gmm
from training.data.corpus import Corpus
from training.engine.model_card import Card
from training.engine.publish import publish
from training.engine.recipe import Finished, TrainingJob
from training.gmm.expectation_maximisation import fit_mixture

COMPONENTS = 8
RIDGE = 1e-3
"""rad², added to every variance: joints that never bent in the recordings may bend a little (1.8 degrees)."""
_CARD = Card(
    "Gaussian mixture",
    """A mixture of eight Gaussians over the rotation vectors of the 21 body joints (Bogo et al. 2016), fitted by
expectation maximisation to the distinct poses and their mirror images, without further augmentation.""",
    augmented=False,
)


def train_gmm(job: TrainingJob) -> Finished:
    """Fit, export and measure the mixture.

    Raises:
        JobInvalid: another device than the CPU.
    """
    if job.settings.device != "cpu":
        raise JobInvalid("The mixture is fitted on the CPU alone.", where="device", hint="Leave out --device.")
    x = rotation_vectors(job.training)
    mixture, history = fit_mixture(x, COMPONENTS, job.settings.seed, ridge=RIDGE, progress=job.progress)
    arrays = {
        "weights": mixture.weights.astype(np.float32),
        "means": mixture.means.astype(np.float32),
        "factors": mixture.factors.astype(np.float32),
    }
    held_out = mixture.log_densities(rotation_vectors(job.validation))
    metrics = {
        "train_log_likelihood_nats": history[-1],
        "validation_log_likelihood_nats": float(np.logaddexp.reduce(held_out, axis=1).mean()),
    }
    settings = {"components": COMPONENTS, "ridge": RIDGE, "seed": job.settings.seed}

    def measure(path: Path) -> dict[str, Any]:
        load_gmm(path)
        return {"metrics": metrics}

    return publish(job, "gmm", arrays, {}, settings, measure, _CARD)


def rotation_vectors(corpus: Corpus) -> np.ndarray:
    """Return (2 D, 63) rotation vectors of the distinct poses and their mirror images."""
    vectors = log_so3(corpus.rotations[corpus.distinct].astype(np.float64))
    flipped = vectors[:, BODY_MIRROR] * np.array([1.0, -1.0, -1.0])
    return np.concatenate((vectors, flipped)).reshape(-1, 3 * NUM_BODY_JOINTS)
