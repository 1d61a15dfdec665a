"""Every setting can be given on the command line and in a job file, and both say the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from solver_backend.cli.arguments import READING_ROWS, given_reading, given_settings
from solver_backend.cli.program import parse
from solver_backend.cli.solve_verb import _jobs
from solver_backend.exchange.diagnostics import list_refusals
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.reading_settings import options_of
from solver_backend.exchange.setting import defaults_of_class, settings_of_class
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verbs import VERBS
from solver_backend.job import Job

ROWS = settings_of_class(SolveSettings)
SOLVE = ["solve", "take", "--out", "motion.npz"]
BETAS = [float(k) for k in range(-5, 5)]


def another(name: str) -> tuple[object, list[str]]:
    """Return a value that is not the setting's default, and the words that give it."""
    row, default = ROWS[name], defaults_of_class(SolveSettings)[name]
    if row.kind == "switch":
        return not default, [row.options[0].replace("--", "--no-") if default else row.options[0]]
    value, words = {
        "whole": (4, "4"), "number": (1.5, "1.5"), "file": ("/x/a.json", "/x/a.json"),
        "name_or_file": ("anny", "anny"), "texts": (["cam1"], "cam1"), "numbers": (BETAS, ",".join(map(str, BETAS))),
        "choice": (row.choices[-1].value, row.choices[-1].value) if row.choices else (None, ""),
    }[row.kind]  # fmt: skip
    if name == "accept":
        value, words = [list_refusals()[0]], list_refusals()[0]
    return value, [f"{row.options[0]}={words}"]


@pytest.mark.parametrize("name", ROWS)
def test_a_setting_is_the_same_on_the_command_line_and_in_a_job_file(name: str) -> None:
    value, words = another(name)
    given = given_settings(parse([*SOLVE, *words]))
    assert list(given) == [name]
    job = Job.from_dict({"version": 1, "capture": "take", "out": "motion.npz", "settings": {name: value}})
    assert SolveSettings.from_dict(given) == job.settings != SolveSettings()


READING: dict[str, object] = {
    "fps": 50.0, "joint_set": "COCO_17", "unit": "mm", "up_axis": "-y", "trim": True, "as_calibrated": True,
    "subject_prefix": "Anna,Bo", "person": "2", "camera": ["hall=cam01", "door=cam02"], "offset": ["cam02=-60"],
    "by_order": True, "frames": [3, 40], "stature": 1.8, "scale": 0.303, "level": "on",
    "camera_path": "images.txt",
}  # fmt: skip


@pytest.mark.parametrize(("name", "value"), READING.items())
def test_how_a_capture_is_read_is_the_same_on_the_command_line_and_in_a_job_file(name: str, value: object) -> None:
    given = given_reading(parse([*SOLVE, *options_of({name: value})]))
    assert {name: list(v) if isinstance(v, tuple) else v for name, v in given.items()} == {name: value}
    job = Job.from_dict({"version": 1, "capture": "take", "out": "motion.npz", name: value})
    assert job.reading()[name] == given[name] and job.as_dict()[name] == value
    assert name not in Job.from_dict({"version": 1, "capture": "take", "out": "motion.npz"}).as_dict()


def test_every_setting_of_how_a_capture_is_read_is_tried() -> None:
    assert list(READING) == list(READING_ROWS)


def test_every_option_of_a_solve_reaches_its_job() -> None:
    """An option that is no field of the job and no setting would be lost without an error."""
    taken_apart = {"job", "allow_outside", "scheduler", "tls", "preset", "json", "verbose", "parent_pipe"}
    names = {row.name for row in VERBS["solve"].settings} - taken_apart
    assert names <= {*ROWS, *Job.__dataclass_fields__}
    words = ["--report=page.html", "--subject=person.npz", "--labels=names.json", "--strict", "--overwrite"]
    (job,) = _jobs(parse([*SOLVE, *words, "--start-from=cam1=a.npz", "--start-from=b.npz", "--trim", "--sync=off"]))
    written = {"report": "page.html", "subject": "person.npz", "labels": "names.json", "strict": True, "trim": True}
    written |= {"overwrite": True, "start_from": ["cam1=a.npz", "b.npz"]}
    plain = {"version": 1, "capture": "take", "out": "motion.npz", "settings": {"sync": "off"}, **written}
    assert job == Job.from_dict(plain) and job.as_dict() == plain | {"settings": job.as_dict()["settings"]}
    assert _jobs(parse(SOLVE)) == [Job(Path("take"), Path("motion.npz"))]


def test_no_setting_is_given_where_none_stands_on_the_command_line() -> None:
    assert given_settings(parse(SOLVE)) == {}


@pytest.mark.parametrize(
    ("words", "message"), [("--betas=1,tall", "not a list of numbers"), ("--window=few", "is not a whole number")]
)
def test_what_is_no_number_is_refused(words: str, message: str) -> None:
    with pytest.raises(CommandLineInvalid, match=message):
        parse([*SOLVE, words])
