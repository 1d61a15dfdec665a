"""The lifter's training: a few steps teach it something, and what is exported is what was trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.body.body import load_body
from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.priors.lifter import DEFAULT_WEIGHTS, POINTS, load_lifter
from solver_backend.priors.sposer import load_sposer
from tests.support.swaying_corpus import job, swaying
from training.lifter.train import LifterSettings, LifterTask, train_lifter


def task(seed: int = 0) -> LifterTask:
    return LifterTask(swaying(0), swaying(1), load_body(), load_sposer(), LifterSettings(), 16, seed)


def test_people_are_whole_where_it_counts_and_differ_in_shape() -> None:
    people = task()._people(torch.from_numpy(swaying(0).rotations[:32]), torch.Generator().manual_seed(0))
    assert people.points.shape == (32, len(POINTS), 3)
    assert people.seen[:, :4].all() and not people.seen.all()
    assert len(people.betas.unique(dim=0)) == LifterSettings().people
    shoulders = torch.linalg.vector_norm(people.points[:, 0] - people.points[:, 1], dim=-1)
    assert (shoulders > 0.15).all() and (shoulders < 0.6).all()


def test_the_loss_is_the_same_for_the_same_seed() -> None:
    def loss(seed: int) -> float:
        asked, generator = task(seed), torch.Generator().manual_seed(3)
        return asked.loss(asked.draw(generator), generator).item()

    assert loss(0) == loss(0) != loss(1)


def test_training_teaches_and_exports_what_was_trained(tmp_path: Path) -> None:
    untrained = task().evaluate(task().model)
    finished = train_lifter(job(tmp_path, 60))
    assert finished.metrics["points_mm"] < 0.8 * untrained["points_mm"]
    lifter = load_lifter(finished.weights)
    assert lifter.stack.widths == (4 * len(POINTS), 384, 384, 51)
    card = finished.weights.with_suffix(".md").read_text(encoding="utf-8")
    assert lifter.metadata["command"].partition(" --")[2] in card and "points_mm" in card
    assert np.isfinite(lifter.stack(np.zeros((1, 4 * len(POINTS))))).all()


def test_training_goes_on_from_weights(tmp_path: Path) -> None:
    order = job(tmp_path / "on", 1)
    order = replace(order, start=DEFAULT_WEIGHTS, settings=replace(order.settings, learning_rate=1e-6))
    before = load_lifter().stack(np.full((3, 4 * len(POINTS)), 0.1))
    finished = train_lifter(order)
    np.testing.assert_allclose(
        load_lifter(finished.weights).stack(np.full((3, 4 * len(POINTS)), 0.1)), before, atol=1e-2
    )
    with pytest.raises(WeightsInvalid, match="sposer"):
        train_lifter(replace(order, start=DEFAULT_WEIGHTS.with_name("sposer.npz")))
