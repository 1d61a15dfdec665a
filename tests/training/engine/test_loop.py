"""The loop: a killed run resumes to the same weights; other settings are refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from solver_backend.exchange.errors import FileDamaged, NonFiniteData, TrainingMismatch
from tests.support.line_task import SETTINGS, LineTask
from training.engine.loop import run_training


def logged(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines()]


def test_killed_run_resumes_to_the_same_weights(tmp_path: Path) -> None:
    whole = run_training(LineTask(), SETTINGS, tmp_path / "whole")
    for die_at in (13, 16):
        with pytest.raises(KeyboardInterrupt):
            run_training(LineTask(die_at), SETTINGS, tmp_path / "killed")
    again = run_training(LineTask(), SETTINGS, tmp_path / "killed")
    for a, b in zip(whole.parameters(), again.parameters(), strict=True):
        np.testing.assert_array_equal(a.detach().numpy(), b.detach().numpy())
    lines = [logged(tmp_path / d) for d in ("whole", "killed")]
    assert lines[0] == lines[1] and [x["step"] for x in lines[0]] == [10, 20, 30, 40]


def test_run_killed_between_log_and_checkpoint_logs_no_step_twice(tmp_path: Path) -> None:
    rarely = replace(SETTINGS, checkpoint_s=1e9)
    whole = run_training(LineTask(), rarely, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        run_training(LineTask(33), rarely, tmp_path / "killed")
    assert [x["step"] for x in logged(tmp_path / "killed")] == [10, 20, 30]
    again = run_training(LineTask(), rarely, tmp_path / "killed")
    assert logged(tmp_path / "killed") == logged(tmp_path / "whole")
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), again.parameters(), strict=True))


def test_tensorboard_reads_the_curves(tmp_path: Path) -> None:
    accumulators = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    with pytest.raises(KeyboardInterrupt):
        run_training(LineTask(35), SETTINGS, tmp_path)
    run_training(LineTask(), SETTINGS, tmp_path)
    read = accumulators.EventAccumulator(str(tmp_path / "events"))
    read.Reload()
    assert [point.step for point in read.Scalars("training/loss")] == [20, 40]
    assert [point.step for point in read.Scalars("validation/weight")] == [10, 20, 30, 40]
    last = logged(tmp_path)[-1]
    assert read.Scalars("training/loss")[-1].value == pytest.approx(last["loss"], rel=1e-6)
    assert read.Scalars("validation/weight")[-1].value == pytest.approx(last["weight"], rel=1e-6)


def test_damaged_checkpoints_and_other_networks_are_named(tmp_path: Path) -> None:
    run_training(LineTask(), SETTINGS, tmp_path)
    other = LineTask()
    other.model = nn.Sequential(nn.Linear(2, 8), nn.Tanh(), nn.Dropout(0.2), nn.Linear(8, 1))
    with pytest.raises(TrainingMismatch, match="another network"):
        run_training(other, SETTINGS, tmp_path)
    (tmp_path / "checkpoint.pt").write_bytes(b"half a file")
    with pytest.raises(FileDamaged, match=r"cannot be read.*checkpoint\.pt"):
        run_training(LineTask(), SETTINGS, tmp_path)


def test_finished_run_is_not_trained_again(tmp_path: Path) -> None:
    first = run_training(LineTask(), SETTINGS, tmp_path)
    second = run_training(LineTask(die_at=0), SETTINGS, tmp_path)
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))


def test_other_settings_are_refused(tmp_path: Path) -> None:
    run_training(LineTask(), SETTINGS, tmp_path)
    with pytest.raises(TrainingMismatch, match=r"other learning_rate, seed.*another folder"):
        run_training(LineTask(), replace(SETTINGS, seed=3, learning_rate=1.0, checkpoint_s=9.0), tmp_path)


def test_losses_fall(tmp_path: Path) -> None:
    task, settings = LineTask(), replace(SETTINGS, steps=300, learning_rate=1e-2)
    run_training(task, settings, tmp_path)
    losses = [line["loss"] for line in logged(tmp_path)]
    assert losses[-1] < 0.3 * losses[0]


def test_a_loss_that_is_no_number_is_named_and_the_checkpoint_stays(tmp_path: Path) -> None:
    run_training(LineTask(), replace(SETTINGS, steps=20), tmp_path / "sound")
    task, before = LineTask(), (tmp_path / "sound" / "checkpoint.pt").read_bytes()
    (tmp_path / "run").mkdir()
    loss = task.loss
    task.loss = lambda batch, generator: float("nan") * loss(batch, generator)  # type: ignore[method-assign]
    with pytest.raises(NonFiniteData, match="not a number at step"):
        run_training(task, SETTINGS, tmp_path / "run")
    assert not (tmp_path / "run" / "checkpoint.pt").exists()
    assert (tmp_path / "sound" / "checkpoint.pt").read_bytes() == before
