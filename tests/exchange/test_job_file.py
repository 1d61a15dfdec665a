"""The job the add-on writes is one the solver reads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from blender_addon._exchange.errors import OutputNotWritable
from blender_addon._exchange.job_file import JobFile, JobPin, JobRange, write_job
from solver_backend.exchange.solve_settings import PRESETS, SolveSettings
from solver_backend.job import Job as SolverJob


@pytest.mark.parametrize("preset", PRESETS)
def test_the_solver_reads_each_preset(tmp_path, preset):
    job = JobFile(
        capture=tmp_path / "Aufnahme ü.npz", out=tmp_path / "take 01.npz", report=tmp_path / "a.html",
        settings={**PRESETS[preset], "betas": [0.5] * 10},
    )  # fmt: skip
    write_job(tmp_path / "take.job.json", job)
    read = SolverJob.read(tmp_path / "take.job.json")
    assert (read.capture, read.out, read.report) == (job.capture, job.out, job.report)
    assert read.settings == SolveSettings.from_dict({**PRESETS[preset], "betas": [0.5] * 10})
    assert [path.name for path in tmp_path.iterdir()] == ["take.job.json"]


def test_a_stretch_with_pins_is_plain_json(tmp_path):
    pin = JobPin(150, (0.1, 0.2, 0.3), [0.0] * 69, (1, 2, 3))
    job = JobFile(Path("c.npz"), Path("n.npz"), resolve=JobRange(Path("m.npz"), 120, 180, (pin,)))
    write_job(tmp_path / "job.json", job)
    assert json.loads((tmp_path / "job.json").read_text("utf-8"))["resolve"] == {
        "motion": "m.npz", "first": 120, "last": 180,
        "pins": [{"frame": 150, "global_orient": [0.1, 0.2, 0.3], "body_pose": [0.0] * 69, "transl": [1.0, 2.0, 3.0]}],
    }  # fmt: skip


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputNotWritable, match="The job cannot be written") as caught:
        write_job(tmp_path / "file" / "job.json", JobFile(Path("c.npz"), Path("n.npz")))
    assert "free space" in caught.value.hint


def test_a_strict_job_is_plain_json(tmp_path):
    write_job(tmp_path / "job.json", JobFile(Path("c.npz"), Path("n.npz"), strict=True))
    assert json.loads((tmp_path / "job.json").read_text("utf-8"))["strict"] is True
    assert SolverJob.read(tmp_path / "job.json").strict
