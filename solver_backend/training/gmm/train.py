"""The Gaussian mixture from corpus to weights."""

from __future__ import annotations

from typing import Any

import numpy as np

from solver_backend.exchange.errors import JobInvalid
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.gmm import load_gmm
from solver_backend.training.data.corpus import Corpus
from solver_backend.training.data.rest_skeleton import MIRROR
from solver_backend.training.engine.export_weights import export_prior
from solver_backend.training.engine.model_card import write_model_card
from solver_backend.training.engine.recipe import Finished, Job
from solver_backend.training.gmm.expectation_maximisation import fit_mixture
from solver_backend.types.joint_sets import NUM_BODY_JOINTS

COMPONENTS = 8
RIDGE = 1e-3
"""rad², added to every variance: joints that never bent in the recordings may bend a little (1.8 degrees)."""
_SUMMARY = """A mixture of eight Gaussians over the rotation vectors of the 21 body joints (Bogo et al. 2016), fitted by
expectation maximisation to the distinct poses and their mirror images, without further augmentation."""


def train_gmm(job: Job) -> Finished:
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
    metadata: dict[str, Any] = {
        "command": job.command,
        "settings": {"components": COMPONENTS, "ridge": RIDGE, "seed": job.settings.seed},
        "data": job.data,
        "metrics": {
            "train_log_likelihood_nats": history[-1],
            "validation_log_likelihood_nats": float(np.logaddexp.reduce(held_out, axis=1).mean()),
        },
    }
    path = job.out / "gmm.npz"
    metadata["sha256"] = export_prior(path, "gmm", arrays, metadata)
    load_gmm(path)
    write_model_card(path.with_suffix(".md"), "Gaussian mixture", _SUMMARY, metadata, augmented=False)
    return Finished(path, metadata["metrics"])


def rotation_vectors(corpus: Corpus) -> np.ndarray:
    """Return (2 D, 63) rotation vectors of the distinct poses and their mirror images."""
    vectors = log_so3(corpus.rotations[corpus.distinct].astype(np.float64))
    swapped = [MIRROR[joint] - 1 for joint in range(1, 22)]
    flipped = vectors[:, swapped] * np.array([1.0, -1.0, -1.0])
    return np.concatenate((vectors, flipped)).reshape(-1, 3 * NUM_BODY_JOINTS)
