"""Pages that are made from the program's tables are those of today's tables."""

from __future__ import annotations

import re

import pytest

from solver_backend.exchange.diagnostics import load_table
from supply.pages import FOLDER, PAGES


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_up_to_date(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == PAGES[name](), "python3 dev.py docs writes it anew"


def test_every_code_has_an_anchor_and_a_link() -> None:
    found = {
        (name, line[3:])
        for name, page in PAGES.items()
        if name.startswith("reference/diagnostics-")
        for line in page().splitlines()
        if line.startswith("## ")
    }
    assert sorted(code for _, code in found) == sorted(load_table())
    links = set(re.findall(r"\((diagnostics-[\w-]+\.md)#(\w+)\)", PAGES["reference/diagnostics.md"]()))
    assert {(f"reference/{page}", code) for page, code in links} == found
