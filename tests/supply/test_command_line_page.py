"""The page of the command line is complete: every verb with each of its options, or with the page that has them."""

from __future__ import annotations

import argparse
import re

from solver_backend.cli.arguments import build_parser
from supply.command_line_page import command_line_page

SETTINGS = "It also takes the [settings of a solve]"
PAGE = command_line_page()


def section(verb: str) -> str:
    return re.split(r"^#", PAGE.split(f"#### {verb}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def test_a_verb_lists_every_option_or_the_page_that_has_them() -> None:
    [verbs] = [a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    without = [
        (verb, action.option_strings)
        for verb, own in verbs.choices.items()
        if SETTINGS not in section(verb)
        for action in own._actions
        if action.option_strings and action.help != argparse.SUPPRESS and action.dest != "help"
        and not any(f"`{name}`" in section(verb) for name in action.option_strings)
    ]  # fmt: skip
    assert not without


def test_the_settings_of_a_solve_are_claimed_where_they_are() -> None:
    assert SETTINGS in section("solve") and SETTINGS in section("from-videos")
    assert SETTINGS not in section("record-oak") and "`none\\|wire\\|ptp`" in section("record-oak")


def test_an_option_of_a_settings_name_is_described_where_it_is_another() -> None:
    assert "keypoints" in section("from-videos").split("`--sync`", 1)[1].splitlines()[0]
