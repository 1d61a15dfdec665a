"""Every setting can be given on the command line and in a job file, and both say the same."""

from __future__ import annotations

import pytest

from solver_backend.cli.arguments import parse
from solver_backend.cli.setting_options import ROWS, given_settings, given_world, option
from solver_backend.exchange.diagnostics import REFUSALS
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.setting import defaults_of_class
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.job import Job

SOLVE = ["solve", "take", "--out", "motion.npz"]
BETAS = [float(k) for k in range(-5, 5)]


def another(name: str) -> tuple[object, list[str]]:
    """Return a value that is not the setting's default, and the words that give it."""
    row, default = ROWS[name], defaults_of_class(SolveSettings)[name]
    if row.kind == "switch":
        return not default, [option(name).replace("--", "--no-") if default else option(name)]
    value, words = {
        "whole": (7, "7"), "number": (1.5, "1.5"), "file": ("/x/a.json", "/x/a.json"),
        "name_or_file": ("anny", "anny"), "texts": (["cam1"], "cam1"), "numbers": (BETAS, ",".join(map(str, BETAS))),
        "choice": (row.choices[-1].value, row.choices[-1].value) if row.choices else (None, ""),
    }[row.kind]  # fmt: skip
    if name == "accept":
        value, words = [REFUSALS[0]], REFUSALS[0]
    return value, [f"{option(name)}={words}"]


@pytest.mark.parametrize("name", ROWS)
def test_a_setting_is_the_same_on_the_command_line_and_in_a_job_file(name: str) -> None:
    value, words = another(name)
    given = given_settings(parse([*SOLVE, *words]))
    assert list(given) == [name]
    job = Job.from_dict({"version": 1, "capture": "take", "out": "motion.npz", "settings": {name: value}})
    assert SolveSettings.from_dict(given) == job.settings != SolveSettings()


@pytest.mark.parametrize(("name", "value"), [("stature", 1.8), ("scale", 0.303), ("level", "on")])
def test_the_world_is_the_same_on_the_command_line_and_in_a_job_file(name: str, value: object) -> None:
    assert given_world(parse([*SOLVE, f"--{name}={value}"])) == {name: value}
    job = Job.from_dict({"version": 1, "capture": "take", "out": "motion.npz", name: value})
    assert job.reading()[name] == value and job.as_dict()[name] == value
    assert name not in Job.from_dict({"version": 1, "capture": "take", "out": "motion.npz"}).as_dict()


def test_no_setting_is_given_where_none_stands_on_the_command_line() -> None:
    assert given_settings(parse(SOLVE)) == {}


@pytest.mark.parametrize(("words", "message"), [("--betas=1,tall", "not a list of numbers"), ("--window=few", "int")])
def test_what_is_no_number_is_refused(words: str, message: str) -> None:
    with pytest.raises(CommandLineInvalid, match=message):
        parse([*SOLVE, words])
