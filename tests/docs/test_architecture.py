"""The page that says where each formula stands is right: the file is there and names the equation."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "explanation" / "formulas.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ((?:Pose-NDF eq\. |[A-Z][^|\d]+ )?\d[^|]*) \| [^|]+ \| `([^`]+)` \|$", PAGE, flags=re.MULTILINE)


def test_the_table_is_read_whole() -> None:
    assert len(ROWS) == PAGE.count("\n| ") - 1


@pytest.mark.parametrize(("formulas", "path"), ROWS)
def test_the_file_names_its_equations(formulas: str, path: str) -> None:
    text = (ROOT / path).read_text(encoding="utf-8")
    for number in re.findall(r"\d+(?:\.\d+)*", formulas):
        major, _, minor = number.rpartition(".")
        prefix = re.escape(major) + r"\."
        spans = re.findall(rf"\b{prefix}(\d+)(?:-| to ){prefix}(\d+)", text) if major else []
        within = any(int(first) <= int(minor) <= int(last) for first, last in spans)
        assert within or re.search(rf"(?<![\d.]){re.escape(number)}(?!\.?\d)", text), f"{path} does not name {number}"
