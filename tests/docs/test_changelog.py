"""The changelog is short: each entry has two lines at most and stands in a group of what a user notices."""

from __future__ import annotations

import re
from pathlib import Path

TEXT = (Path(__file__).resolve().parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
GROUPS = {
    "Captures", "Videos and cameras", "Markers", "Sensors and studio", "Solve", "Blender", "Headless", "Safety"
}  # fmt: skip
MOST_LINES = 2


def test_an_entry_has_two_lines_at_most() -> None:
    entries = re.findall(r"^- .*(?:\n  .*)*", TEXT, flags=re.MULTILINE)
    assert len(entries) > 50
    assert [entry for entry in entries if entry.count("\n") >= MOST_LINES] == []


def test_groups_are_what_a_user_notices() -> None:
    assert set(re.findall(r"^### (.+)$", TEXT, flags=re.MULTILINE)) <= GROUPS
