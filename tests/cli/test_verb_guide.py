"""Every verb stands under one task, with an example that its own parser takes."""

from __future__ import annotations

import argparse

import pytest

from solver_backend.cli.arguments import build_parser, parse
from solver_backend.cli.verb_guide import EXAMPLES, TASKS


def verbs() -> dict[str, argparse.ArgumentParser]:
    (action,) = [a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(action.choices)


def test_every_verb_has_a_task_and_no_row_is_of_nothing() -> None:
    rows = [verb for task in TASKS.values() for verb in task]
    assert sorted(rows) == sorted(verbs())


@pytest.mark.parametrize("verb", EXAMPLES)
def test_an_example_is_taken_by_its_parser_and_shown_in_its_help(verb: str) -> None:
    words = EXAMPLES[verb].split()
    assert parse(words).verb == verb == words[0]
    assert f"example:\n  python -m solver_backend {EXAMPLES[verb]}" in verbs()[verb].format_help()


def test_help_lists_each_verb_under_its_task() -> None:
    text = build_parser().format_help()
    for task, rows in TASKS.items():
        block = text.split(f"\n{task}:\n")[1].split("\n\n")[0]
        assert [line.split()[0] for line in block.splitlines()] == list(rows)
