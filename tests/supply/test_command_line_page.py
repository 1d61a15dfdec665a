"""The page of the command line is complete: every verb with each of its options, or with the page that has them."""

from __future__ import annotations

import re

import pytest

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS
from solver_backend.exchange.diagnostics import list_refusals
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.exchange.setting import settings_of_class
from solver_backend.exchange.solve_settings import METHOD_NAMES, SolveSettings
from solver_backend.exchange.verbs import GROUPS, VERBS, shared
from solver_backend.fitters.pose_ndf.complete import LIMBS
from solver_backend.io.units_and_axes import METRES, UP_AXES
from solver_backend.synthesis.studio.benchmark.solve_and_compare import YARDSTICK
from solver_backend.synthesis.studio.spec import PRESETS
from supply.command_line_page import command_line_page, group_page
from supply.settings_page import settings_page

LINKS = {"[solve settings](": "SOLVING", "[reading options](": "READING", "[world options](": "WORLD"}
"""Named settings that a section replaces by a link to their page."""
PAGE = "\n".join([command_line_page(), *map(group_page, GROUPS)])


def section(verb: str) -> str:
    return re.split(r"^#", PAGE.split(f"## {verb}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def test_a_verb_lists_every_option_or_the_page_that_has_them() -> None:
    linked = {name: [row for link in LINKS if link in section(name) for row in shared()[LINKS[link]]] for name in VERBS}
    without = [
        (name, row.options)
        for name, verb in VERBS.items()
        for row in verb.settings
        if row.options and row not in linked[name] and not any(f"`{option}`" in section(name) for option in row.options)
    ]
    assert not without
    pages = settings_page()
    assert all(f"| `{row.name}` |" in pages for rows in linked.values() for row in rows)


def test_an_option_that_a_section_names_is_described_once_on_its_page() -> None:
    for page in (command_line_page(), *map(group_page, GROUPS)):
        tables = page.partition("\n## Common ")
        named = set(re.findall(r"\[(`[^\]]*)\]\(#common-(?:arguments|options)\)", tables[0]))
        names = {name for group in named for name in re.findall(r"`[^`]+`", group)}
        assert not [name for name in names if not re.search(rf"^\| .*{re.escape(name[:-1])}", tables[2], re.MULTILINE)]


def test_the_settings_of_a_solve_are_claimed_where_they_are() -> None:
    assert "[solve settings](" in section("solve") and "[solve settings](" in section("from-videos")
    assert not any(link in section("sensors record") for link in LINKS)
    assert "`none\\|wire\\|ptp`" in group_page("sensors")


def test_an_option_of_a_settings_name_is_described_where_it_is_another() -> None:
    assert "[`--detector`, `--detector-worker`" in section("from-videos") and "`--sync`" in section("from-videos")
    [row] = [line for line in command_line_page().splitlines() if line.startswith("| `--sync`")]
    assert "keypoints" in row


_LAYOUTS = load_layouts()
METHODS = (*METHOD_NAMES, YARDSTICK)


@pytest.mark.parametrize(
    ("verb", "option", "values"),
    [
        ("cameras calibrate", "--lens", tuple(LENS_MODELS)),
        ("dataset benchmark", "--methods", METHODS),
        ("dataset make", "--benchmark", METHODS),
        ("dataset cameras", "--faults", tuple(PRESETS)),
        ("markers places", "--layout", (*_LAYOUTS.layouts, *_LAYOUTS.label_sets)),
        ("motion complete", "--missing", tuple(LIMBS)),
        ("motion convert", "--unit", tuple(METRES)),
        ("motion convert", "--up-axis", tuple(UP_AXES)),
        ("Settings", "joint_set", tuple(JointSet)),
        ("Settings", "unit", tuple(METRES)),
        ("Settings", "up_axis", tuple(UP_AXES)),
        ("batch", "--accept", list_refusals()),
    ],
)
def test_an_option_with_few_values_lists_them(verb: str, option: str, values: tuple[str, ...]) -> None:
    page = f"## Settings\n{re.sub(r'^#.*', '', settings_page(), flags=re.MULTILINE)}" if verb == "Settings" else PAGE
    parts = [re.split(r"^##? ", part, maxsplit=1, flags=re.MULTILINE)[0] for part in page.split(f"## {verb}\n")[1:]]
    rows = [line for part in parts for line in part.splitlines() if f"`{option}`" in line and line.startswith("|")]
    assert rows and all(re.search(rf"(?<![\w-]){re.escape(value)}(?![\w-])", row) for row in rows for value in values)


def test_the_accepted_codes_are_named_in_the_help() -> None:
    description = settings_of_class(SolveSettings)["accept"].description
    assert all(code in description for code in list_refusals())
