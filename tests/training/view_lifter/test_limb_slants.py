"""The limbs' slants: a few steps teach something, and what ships is what was trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from solver_backend.priors.view_lifter import load_limb_slants, load_view_lifter
from tests.support.swaying_corpus import job as plain_job
from tests.support.swaying_corpus import turning
from training.view_lifter.limb_slants import LimbSlantSettings, train_limb_slants


def test_training_teaches_and_exports_what_was_trained(tmp_path: Path) -> None:
    torch.set_num_threads(1)
    asked = plain_job(tmp_path, 60)
    order = type(asked)(**{**vars(asked), "training": turning(0), "validation": turning(0)})
    finished = train_limb_slants(order, LimbSlantSettings(windows=150, unseen=60, exchanged=0))
    assert finished.metrics["cross_entropy"] < 0.9 < np.log(3)
    slants = load_limb_slants(finished.weights)
    chances = slants(np.zeros((2, load_view_lifter().width)))
    np.testing.assert_allclose(chances.sum(axis=-1), 1.0)
    card = finished.weights.with_suffix(".md").read_text(encoding="utf-8")
    assert slants.metadata["command"].partition(" --")[2] in card and "flips_flagged_percent" in card
