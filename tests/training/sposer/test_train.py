"""SPoser's training: it learns, and what is exported is what was learned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import TrainingMismatch
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.weights import read_weights
from tests.support.swaying_corpus import job, swaying
from training.engine.accuracy import reconstruction_accuracy
from training.sposer.train import SPoserSettings, train_sposer


def test_sposer_learns_and_exports_what_it_learned(tmp_path: Path) -> None:
    settings = SPoserSettings(encoder_hidden=(64,), decoder_hidden=(64, 48))
    finished = train_sposer(job(tmp_path, 450), settings)
    prior = load_sposer(finished.weights)
    assert prior.widths == ((126, 64, 32), (32, 64, 48, 126))
    assert finished.metrics["mpjpe_mm"] < 25.0
    truth = swaying(0).rotations[::3].astype(np.float64)
    assert reconstruction_accuracy(truth, prior.decode(prior.encode(truth))).mpjpe_mm < 25.0
    assert prior.metadata["sha256"] in finished.weights.with_suffix(".md").read_text(encoding="utf-8")


def test_training_goes_on_from_weights_and_says_so(tmp_path: Path) -> None:
    settings = SPoserSettings(encoder_hidden=(64,), decoder_hidden=(48,))
    first = train_sposer(job(tmp_path / "first", 300), settings)
    start = load_sposer(first.weights).metadata["sha256"]
    order = job(tmp_path / "second", 20)
    order = replace(order, start=first.weights, settings=replace(order.settings, start=start, learning_rate=1e-4))
    second = train_sposer(replace(order, far=swaying(3)), settings)
    assert second.metrics["mpjpe_mm"] < 1.1 * first.metrics["mpjpe_mm"]
    card = second.weights.with_suffix(".md").read_text(encoding="utf-8")
    assert f"| `start` | {start} |" in card
    log = (order.work / "log.jsonl").read_text(encoding="utf-8")
    assert "far_worst5_mpjpe_mm" in log
    with pytest.raises(TrainingMismatch, match=r"layers of \(126, 64, 32\), the network has \(126, 32, 32\)"):
        train_sposer(replace(order, work=tmp_path / "third"), replace(settings, encoder_hidden=(32,)))
    with pytest.raises(TrainingMismatch, match="other start"):
        train_sposer(replace(order, settings=replace(order.settings, start="")), settings)


def test_an_encoder_trained_alone_leaves_the_decoder_as_it_is(tmp_path: Path) -> None:
    settings = SPoserSettings(encoder_hidden=(64,), decoder_hidden=(48,))
    first = train_sposer(job(tmp_path / "first", 60), settings)
    order = job(tmp_path / "second", 150)
    start = load_sposer(first.weights).metadata["sha256"]
    order = replace(order, start=first.weights, settings=replace(order.settings, start=start, part="encoder"))
    second = train_sposer(order, settings)
    before, after = read_weights(first.weights, "sposer").arrays, read_weights(second.weights, "sposer").arrays
    for name, values in before.items():
        assert np.array_equal(values, after[name]) == name.startswith("decoder_"), name
    assert second.metrics["mpjpe_mm"] < first.metrics["mpjpe_mm"]
    assert "The encoder was trained alone" in second.weights.with_suffix(".md").read_text(encoding="utf-8")
