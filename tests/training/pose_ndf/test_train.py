"""Pose-NDF's training: it learns, resumes after a kill, and exports what it learned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.priors.pose_ndf import load_pose_ndf
from tests.support.swaying_people import SMALL, job
from training.pose_ndf.network import (
    PoseNdfTask,
)
from training.pose_ndf.train import train_pose_ndf


def test_training_learns_and_exports_what_it_learned(tmp_path: Path) -> None:
    finished = train_pose_ndf(job(tmp_path, 120), SMALL)
    assert finished.metrics["spearman"] > 0.8 and finished.metrics["predicted_lowered_percent"] > 95
    prior = load_pose_ndf(finished.weights)
    card = finished.weights.with_suffix(".md").read_text(encoding="utf-8")
    assert prior.metadata["sha256"] in card and "samples_outside_percent" in card and "mean over the 5" in card
    assert prior.metadata["field_size"]["field_hidden"] == [16, 16]


def test_a_killed_run_resumes_to_the_same_loss_curve_and_weights(tmp_path: Path, monkeypatch) -> None:
    whole = train_pose_ndf(job(tmp_path / "whole", 40), SMALL)
    plain, calls = PoseNdfTask.loss, [0]

    def dying(self: PoseNdfTask, step: int, generator: torch.Generator) -> torch.Tensor:
        calls[0] += 1
        if calls[0] in (5, 14, 27):
            raise KeyboardInterrupt
        return plain(self, step, generator)

    monkeypatch.setattr(PoseNdfTask, "loss", dying)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            train_pose_ndf(job(tmp_path / "killed", 40, checkpoint_s=0.0), SMALL)
    again = train_pose_ndf(job(tmp_path / "killed", 40, checkpoint_s=0.0), SMALL)
    for stage in range(1, 4):
        logs = [tmp_path / run / "run" / f"stage{stage}" / "log.jsonl" for run in ("whole", "killed")]
        curves = [log.read_text(encoding="utf-8").splitlines() for log in logs]
        assert curves[0] == curves[1] and len(curves[0]) >= 2
    first, second = (np.load(x.weights, allow_pickle=False) for x in (whole, again))
    assert all(np.array_equal(first[key], second[key]) for key in first.files if key != "header")
