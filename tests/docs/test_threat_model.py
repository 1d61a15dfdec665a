"""The threat model: every test that it names is there, and every row of what was found names one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "explanation" / "threat-model.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ([^|]+) \| (`tests/[^|]+) \|$", PAGE.split("## What was found")[1], flags=re.MULTILINE)


def test_every_row_of_what_was_found_is_read() -> None:
    rows = PAGE.split("## What was found")[1].split("## Not answered")[0].count("\n| ")
    assert len(ROWS) == rows - 2, "but for the heads of the two tables"


@pytest.mark.parametrize(("finding", "tests"), ROWS, ids=lambda value: value[:40])
def test_each_finding_has_tests_that_are_there(finding: str, tests: str) -> None:
    named = re.findall(r"`([^`:]+)::(\w+)`", tests)
    assert named, finding
    for path, name in named:
        assert re.search(rf"^def {name}\(", (ROOT / path).read_text(encoding="utf-8"), flags=re.MULTILINE), name


@pytest.mark.parametrize("path", re.findall(r"`(tests/[\w/.]+)`", PAGE.split("## What was found")[0]))
def test_what_holds_a_threat_is_there(path: str) -> None:
    assert (ROOT / path).exists()
