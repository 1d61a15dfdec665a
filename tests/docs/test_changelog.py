"""The changelog stays short."""

from __future__ import annotations

import re
from pathlib import Path

TEXT = (Path(__file__).resolve().parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
MOST_ENTRIES = 10
"""Of one version."""


def test_a_version_has_ten_entries_of_two_lines_at_most() -> None:
    for version in re.split(r"^## ", TEXT, flags=re.MULTILINE)[1:]:
        entries = re.findall(r"^- .*(?:\n  .*)*", version, flags=re.MULTILINE)
        assert 0 < len(entries) <= MOST_ENTRIES
        assert not [entry for entry in entries if entry.count("\n") > 1]
