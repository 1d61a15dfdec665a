"""Every verb is one row of one table: under one task, with an example that its own parser takes."""

from __future__ import annotations

import argparse

import pytest

from solver_backend.cli.arguments import build_parser, parse
from solver_backend.cli.main import function_of
from solver_backend.cli.verb_table import TASKS, VERBS


def verbs() -> dict[str, argparse.ArgumentParser]:
    (action,) = [a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(action.choices)


def test_every_verb_is_one_row() -> None:
    rows = [verb.name for task in TASKS.values() for verb in task]
    assert len(rows) == len(VERBS)
    assert rows == list(verbs())


@pytest.mark.parametrize("name", VERBS)
def test_a_row_names_the_function_that_runs(name: str) -> None:
    assert callable(function_of(name))


@pytest.mark.parametrize("name", VERBS)
def test_an_example_is_taken_by_its_parser_and_shown_in_its_help(name: str) -> None:
    example = VERBS[name].example
    assert parse(example.split()).verb == name == example.split()[0]
    assert f"example:\n  python -m solver_backend {example}" in verbs()[name].format_help()


def test_help_lists_each_verb_under_its_task() -> None:
    text = build_parser().format_help()
    for task, rows in TASKS.items():
        block = text.split(f"\n{task}:\n")[1].split("\n\n")[0]
        assert [line.split()[0] for line in block.splitlines()] == [verb.name for verb in rows]
