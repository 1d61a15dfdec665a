"""Commands in the pages are such that the program takes: verb, options, and the whole line if nothing is open."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Mapping
from pathlib import Path

import pytest

from blender_addon.headless.verb_table import program as blender_program
from solver_backend.cli.program import PROGRAM
from solver_backend.exchange.verb import Verb
from solver_backend.exchange.verbs import GROUPS
from tests.support.page_commands import commands

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
HISTORY = ("research-log", "decisions")
"""Folders of what was run once: their commands are those of their day."""
OPEN = re.compile(r"…|\.\.\.|[A-Z]{2,}|[\[<]|\bVERB\b")
"""What stands for something else: a placeholder, or what is left out."""


LISTED = [
    (path.relative_to(ROOT).as_posix(), program, words)
    for path in PAGES
    if not set(HISTORY) & set(path.parts)
    for program, words in commands(path.read_text(encoding="utf-8"))
]


PROGRAMS = {"solver_backend": PROGRAM, "blender_addon": blender_program()}


def verbs(program: str) -> Mapping[str, Verb]:
    return PROGRAMS[program].verbs


def options_of(program: str, verb: str) -> set[str]:
    own = PROGRAMS[program].parser_of(verbs(program)[verb])
    return {option for action in own._actions for option in action.option_strings}


def verb_of(words: list[str]) -> str:
    return " ".join(words[: 1 + (words[0] in GROUPS)])


def wrong_options(program: str, words: list[str]) -> list[str]:
    """Return the options of a command that its verb has not; of verbs that hand theirs on, the solver's count, too."""
    verb = verb_of(words)
    known = options_of(program, verb)
    if verbs(program)[verb].passes_on:
        known |= options_of("solver_backend", verb)
    named = [word.split("=")[0].rstrip("…]") for word in words if re.match(r"\[?--?[a-z]", word)]
    return [option for option in (word.lstrip("[") for word in named) if option not in known]


def test_the_pages_hold_commands_of_both_programs() -> None:
    assert len(LISTED) > 90
    assert {program for _, program, _ in LISTED} == {"solver_backend", "blender_addon"}


@pytest.mark.parametrize(("page", "program", "words"), LISTED, ids=[f"{p}: {' '.join(w)[:60]}" for p, _, w in LISTED])
def test_a_command_is_one_that_the_program_takes(page: str, program: str, words: list[str]) -> None:
    if words[0] in GROUPS and words[1:2] in ([], ["VERB"]):
        return
    assert verb_of(words) in verbs(program), f"{page}: {program} has no verb {verb_of(words)}"
    assert not wrong_options(program, words), f"{page}: {' '.join(words)}"
    if words == verb_of(words).split() or OPEN.search(" ".join(words)):
        return
    PROGRAMS[program].parse(words)


def test_a_wrong_command_is_found() -> None:
    [(program, words)] = commands("Run `.venv/bin/python -m solver_backend solve capture \\\n  --speed 3`.")
    assert (program, words) == ("solver_backend", ["solve", "capture", "--speed", "3"])
    assert wrong_options(program, words) == ["--speed"]


def test_each_line_of_a_block_is_a_command() -> None:
    found = commands("```sh\nmanifold info a\nmanifold blender bake b --out c\n```")
    assert [words[0] for _, words in found] == ["info", "bake"]


_FOREIGN = {"--command", "--upgrade", "--pred-out-dir", "--write", "--version", "--no", "--nthreads", "--help-all"}
"""Options of other programs and of all verbs that messages name, and the beginning of a switch."""
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*[a-z]")
_VERB = re.compile(r"(?:\b(?:manifold|python -m solver_backend) |`)(?!python )([a-z][a-z-]+)((?: [a-z][a-z-]+){1,2})")
_SENTENCE = re.compile(r"[a-z)`'\"]\.? |\.$")


def _remedies() -> list[tuple[str, str]]:
    """Return the place and text of each sentence of the code and of the diagnostics' table, without docstrings."""
    code = [
        (f"{path.relative_to(ROOT)}:{text.lineno}", str(text.value))
        for package in ("solver_backend", "blender_addon")
        for path in sorted((ROOT / package).rglob("*.py"))
        for text in _texts(ast.parse(path.read_text(encoding="utf-8")))
        if _SENTENCE.search(text.value) and not text.value.startswith("--")  # arguments of a process
    ]
    table = json.loads((ROOT / "solver_backend/exchange/diagnostics.json").read_text(encoding="utf-8"))
    rows = [(name, text) for group in table.values() for name, row in group.items() for text in row.values()]
    return [*code, *((name, text) for name, text in rows if isinstance(text, str))]


def _texts(module: ast.Module) -> list[ast.Constant]:
    nodes = list(ast.walk(module))
    alone = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    return [n for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in alone]


def test_a_remedy_names_options_and_verbs_that_exist() -> None:
    """A hint such as *Pass --rate* sends people in circles if nothing takes it."""
    known = {option for program in PROGRAMS for verb in verbs(program) for option in options_of(program, verb)}
    remedies = _remedies()
    assert sum("--" in text for _, text in remedies) > 100
    wrong = [
        (place, option)
        for place, text in remedies
        for option in _OPTION.findall(text)
        if option not in known | _FOREIGN
    ]
    known_verbs = {*verbs("solver_backend"), *(f"blender {verb}" for verb in verbs("blender_addon"))}
    unknown = [
        (place, f"{first}{rest}")
        for place, text in remedies
        for first, rest in _VERB.findall(text)
        if first in {verb.split()[0] for verb in known_verbs}
        and not any(f"{first}{rest} ".startswith(f"{verb} ") for verb in known_verbs | GROUPS.keys())
    ]
    assert not wrong and not unknown
