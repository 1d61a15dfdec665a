"""SPoser's training: it learns, and what is exported is what was learned."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.priors.sposer import load_sposer
from solver_backend.training.engine.accuracy import reconstruction_accuracy
from solver_backend.training.sposer.task import SPoserSettings
from solver_backend.training.sposer.train import train_sposer
from tests.support.swaying_corpus import job, swaying


def test_sposer_learns_and_exports_what_it_learned(tmp_path: Path) -> None:
    settings = SPoserSettings(encoder_hidden=(64,), decoder_hidden=(64, 48))
    finished = train_sposer(job(tmp_path, 250), settings)
    prior = load_sposer(finished.weights)
    assert prior.widths == ((126, 64, 32), (32, 64, 48, 126))
    assert finished.metrics["mpjpe_mm"] < 25.0
    truth = swaying(0).rotations[::3].astype(np.float64)
    assert reconstruction_accuracy(truth, prior.decode(prior.encode(truth))).mpjpe_mm < 25.0
    assert prior.metadata["sha256"] in finished.weights.with_suffix(".md").read_text(encoding="utf-8")
