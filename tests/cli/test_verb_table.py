"""Every verb is one row of one table: under one task, with an example that its own parser takes."""

from __future__ import annotations

import re
from itertools import groupby
from pathlib import Path

import pytest

from blender_addon.headless.verb_table import program
from solver_backend.cli.main import function_of, main
from solver_backend.cli.program import PROGRAM, parse
from solver_backend.exchange.errors import CommandLineInvalid, ExitCode
from solver_backend.exchange.verbs import GROUPS, VERBS

ROOT = Path(__file__).resolve().parents[2]


def test_every_verb_has_a_name_of_its_own_and_verbs_of_a_group_stand_together() -> None:
    assert [verb.name for verb in VERBS.values()] == list(VERBS)
    groups = [group for group, _ in groupby(VERBS.values(), key=lambda verb: verb.group)]
    assert groups == ["", *(group for group in GROUPS if group != "blender")]
    assert len(GROUPS) + sum(not verb.group for verb in VERBS.values()) <= 15


@pytest.mark.parametrize("name", VERBS)
def test_a_row_names_the_function_that_runs(name: str) -> None:
    assert callable(function_of(name))


@pytest.mark.parametrize("name", VERBS)
def test_an_example_is_taken_by_its_parser_and_shown_in_its_help(name: str) -> None:
    example = VERBS[name].example
    assert parse(example.split()).verb == name and example.startswith(name)
    assert f"example:\n  manifold {example}" in PROGRAM.parser_of(VERBS[name]).format_help()


@pytest.mark.parametrize("name", VERBS)
def test_the_words_of_an_example_are_made_from_its_values(name: str) -> None:
    """Panels and batches start verbs by values: their words are read back as the same values."""
    verb, args = VERBS[name], parse(VERBS[name].example.split())
    given = {row.name: value for row in verb.settings if (value := getattr(args, row.name)) not in (None, row.default)}
    again = parse([name, *verb.words(given)])
    assert {name: getattr(again, name) for name in given} == given
    assert given or name in ("motion bodies", "sensors list")


@pytest.mark.parametrize("verbs", [VERBS, program().verbs], ids=["solver", "blender"])
def test_the_settings_of_a_verb_have_names_and_options_of_their_own(verbs: dict) -> None:
    for verb in verbs.values():
        options = [option for row in verb.settings for option in row.options]
        assert len(verb.rows) == len(verb.settings) and len(set(options)) == len(options), verb.name
        assert all(row.description[0].isupper() and not row.description.endswith(".") for row in verb.settings)


def test_help_lists_groups_and_the_verbs_of_a_group() -> None:
    def listed(title: str, group: str = "") -> list[str]:
        block = PROGRAM.parser(group).format_help().split(f"\n{title}:\n")[1].split("\n\n")[0]
        return [line.split()[0] for line in block.splitlines()]

    assert listed("groups of verbs") == list(GROUPS)
    for group, rows in groupby(VERBS.values(), key=lambda verb: verb.group):
        assert listed("verbs", group) == [verb.name.split()[-1] for verb in rows]


def test_the_group_blender_is_the_program_of_the_add_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("blender_addon.headless.process.leave", lambda code: code)  # which ends the process at once
    assert main(["blender", "bake", "--help"]) == ExitCode.RESULT
    assert capsys.readouterr().out.startswith("usage: manifold blender bake MOTION.npz")
    assert main(["blender", "bakee", "--json"]) == ExitCode.USAGE
    assert "Did you mean bake?" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["slove"], "Did you mean solve?"),
        (["calibrate-cameras", "boards"], "Did you mean cameras calibrate?"),
        (["calibrate"], "Did you mean cameras calibrate, markers calibrate or sensors calibrate?"),
        (["live", "take.c3d"], "live needs one of its verbs: stream, cameras."),
        (["solve", "take", "--out", "m.npz", "--smothing", "3"], "Did you mean --smoothing?"),
    ],
)
def test_a_word_that_is_almost_known_is_suggested(words: list[str], hint: str) -> None:
    with pytest.raises(CommandLineInvalid) as caught:
        parse(words)
    assert caught.value.hint == hint


def test_every_verb_with_an_output_takes_its_short_option() -> None:
    assert str(parse(["convert", "take", "-o", "take.npz"]).out) == "take.npz"
    rows = [row for verb in (*VERBS.values(), *program().verbs.values()) for row in verb.settings if row.name == "out"]
    assert all(row.positional or row.options == ("-o", "--out") for row in rows)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["live cameras", "a", "--calibration", "c.toml", "--rate", "500"],
            "500 is not valid. It must be a number from 1 to 240",
        ),
        (["cameras board", "charuco:5x7:35mm", "--out", "board.png"], r"board.png must end in .pdf or .svg"),
        (["dataset demo", "--out", "demo"], "demo must end in .npz"),
        (["motion trim", "a.npz", "b"], "b must end in .npz"),
        (["motion denoise", "a.npz", "b.npz", "--manifold", "nan"], "nan is not valid. It must be a number from 0"),
    ],
)
def test_a_value_is_checked_by_its_row(words: list[str], message: str) -> None:
    with pytest.raises(CommandLineInvalid, match=message):
        parse(words)


def test_no_option_is_declared_outside_the_table() -> None:
    pattern = re.compile(r"\.add_argument\(")
    files = [*(ROOT / "solver_backend").rglob("*.py"), *(ROOT / "blender_addon").rglob("*.py")]
    found = {path.relative_to(ROOT).as_posix() for path in files if pattern.search(path.read_text(encoding="utf-8"))}
    assert found <= {"solver_backend/exchange/verb.py"}


def test_help_is_short_and_help_all_lists_everything(capsys: pytest.CaptureFixture[str]) -> None:
    verb = VERBS["solve"]
    assert main(["solve", "--help"]) == ExitCode.RESULT
    short = capsys.readouterr().out
    assert main(["solve", "--help-all"]) == ExitCode.RESULT
    everything = capsys.readouterr().out
    rare = [row.options[0] for row in verb.settings if row.rare]
    assert rare and all(re.search(f" {option}[ ,]", everything) for option in rare)
    assert not any(re.search(f" {option}[ ,]", short) for option in rare) and f"{len(rare)} rarely used" in short
    assert len(short.splitlines()) <= 70 and short.startswith("usage: manifold solve [CAPTURE]")


def test_the_usage_shows_whether_values_may_go_on() -> None:
    def usage(name: str) -> str:
        return " ".join(PROGRAM.parser_of(VERBS[name]).format_help().split("\n\n")[0].split())

    assert "--frames A B --count N" in usage("motion interpolate")
    many = next(verb for verb in VERBS.values() if any(row.many and row.positional for row in verb.settings))
    assert " ... " in usage(many.name)
