"""The threat model names tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "explanation" / "threat-model.md").read_text(encoding="utf-8")
NAMED = re.findall(r"`(tests/[\w/.]+)`", PAGE.split("## Attacks that were run")[0])


@pytest.mark.parametrize("path", sorted(set(NAMED)))
def test_each_named_test_exists(path: str) -> None:
    assert (ROOT / path).exists()


def test_every_threat_has_a_test() -> None:
    rows = re.findall(r"^\| .* \|$", PAGE.split("## Threats and answers")[1].split("### ")[0], flags=re.MULTILINE)
    assert len(rows) > 10
    assert not [row for row in rows[1:] if "`tests/" not in row.split("|")[3]]
