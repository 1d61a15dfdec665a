"""The order to train a prior: its names, and the command that repeats it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from solver_backend.cli.main import main
from solver_backend.exchange.errors import FileMissing, JobInvalid
from solver_backend.priors.sposer import DEFAULT_WEIGHTS
from training.engine.loop import TrainingSettings
from training.train import _command, train


def test_unknown_prior_is_named(tmp_path: Path) -> None:
    with pytest.raises(JobInvalid, match=r"no prior 'poser' \(known: .*sposer"):
        train("poser", tmp_path, tmp_path)


def test_few_priors_start_from_weights(tmp_path: Path) -> None:
    with pytest.raises(JobInvalid, match="Only sposer and lifter"):
        train("gmm", tmp_path, tmp_path, start=DEFAULT_WEIGHTS)
    with pytest.raises(JobInvalid, match="Only sposer can train a part"):
        train("svae", tmp_path, tmp_path, settings=TrainingSettings(part="encoder"))
    with pytest.raises(JobInvalid, match="needs existing weights"):
        train("sposer", tmp_path, tmp_path, settings=TrainingSettings(part="encoder"))
    with pytest.raises(FileMissing, match="weights"):
        train("sposer", tmp_path, tmp_path, start=tmp_path / "none.npz")


def test_the_command_repeats_what_was_asked_for() -> None:
    asked = TrainingSettings(steps=70, batch=384, learning_rate=1e-3, seed=5)
    line = "manifold train model pose_ndf --data DIR --seed 5 --steps 70 --batch 384 --learning-rate 0.001"
    assert _command("pose_ndf", asked) == line
    assert _command("sposer", TrainingSettings()) == "manifold train model sposer --data DIR --seed 0 --steps 6000"
    assert _command("sposer", TrainingSettings(start="2b")).endswith("--steps 6000 --from WEIGHTS")
    encoder = TrainingSettings(part="encoder", start="2b", steps=9)
    assert _command("sposer", encoder).endswith("--steps 9 --part encoder --from WEIGHTS")


@pytest.mark.shared
def test_a_training_without_some_held_out_subjects_reports_them(shared_data: Path, tmp_path: Path, capsys) -> None:
    folder = tmp_path / "motion_cmu" / "mb2"
    folder.mkdir(parents=True)
    for name in ("02_01", "06_02", "08_01", "13_29"):
        (folder / f"{name}.npz").symlink_to(shared_data / "motion_cmu" / "mb2" / f"{name}.npz")
    assert main(["train model", "gmm", "--data", str(tmp_path), "--out", str(tmp_path / "out"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["absent_subjects"] == ["03", "60_61", "ui_prmd_s07", "ui_prmd_s08"]
    for name in ("08_01", "13_29"):
        (folder / f"{name}.npz").unlink()
    with pytest.raises(FileMissing, match="none of the validation subjects"):
        train("gmm", tmp_path, tmp_path / "out")
