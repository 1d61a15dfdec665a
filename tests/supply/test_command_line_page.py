"""The page of the command line is complete: every verb with each of its options, or with the page that has them."""

from __future__ import annotations

import re

from solver_backend.exchange.verbs import GROUPS, VERBS
from supply.command_line_page import command_line_page, group_page

SETTINGS = "It also takes the [settings of a solve]"
PAGE = "\n".join([command_line_page(), *map(group_page, GROUPS)])


def section(verb: str) -> str:
    return re.split(r"^#", PAGE.split(f"## {verb}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def test_a_verb_lists_every_option_or_the_page_that_has_them() -> None:
    without = [
        (name, row.options)
        for name, verb in VERBS.items()
        if SETTINGS not in section(name)
        for row in verb.settings
        if row.options and not any(f"`{option}`" in section(name) for option in row.options)
    ]
    assert not without


def test_the_settings_of_a_solve_are_claimed_where_they_are() -> None:
    assert SETTINGS in section("solve") and SETTINGS in section("from-videos")
    assert SETTINGS not in section("sensors record") and "`none\\|wire\\|ptp`" in section("sensors record")


def test_an_option_of_a_settings_name_is_described_where_it_is_another() -> None:
    assert "keypoints" in section("from-videos").split("`--sync`", 1)[1].splitlines()[0]
