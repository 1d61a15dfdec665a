"""Pages that are made from the program's tables are those of today's tables."""

from __future__ import annotations

import pytest

from solver_backend.exchange.diagnostics import load_table
from supply.pages import FOLDER, PAGES


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_up_to_date(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == PAGES[name](), "python3 dev.py docs writes it anew"


def test_every_code_is_on_the_page() -> None:
    rows = [line for line in PAGES["reference/diagnostics.md"]().splitlines() if line.startswith("| `")]
    assert sorted(row.split("`")[1] for row in rows) == sorted(load_table())
