"""The order to train a prior: its names, and the command that repeats it."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.exchange.errors import JobInvalid
from solver_backend.training.engine.loop import TrainingSettings
from solver_backend.training.train import _command, train


def test_unknown_prior_is_named(tmp_path: Path) -> None:
    with pytest.raises(JobInvalid, match=r"no prior 'poser' \(known: .*sposer"):
        train("poser", tmp_path, tmp_path)


def test_the_command_repeats_what_was_asked_for() -> None:
    asked = TrainingSettings(steps=70, batch=384, learning_rate=1e-3, seed=5)
    line = "python -m solver_backend train pose_ndf --data DIR --seed 5 --steps 70 --batch 384 --learning-rate 0.001"
    assert _command("pose_ndf", asked) == line
    assert (
        _command("sposer", TrainingSettings())
        == "python -m solver_backend train sposer --data DIR --seed 0 --steps 6000"
    )
