"""The reference page of settings is the one that their rows make."""

from __future__ import annotations

from solver_backend.exchange.reading_settings import ROWS as READING_ROWS
from solver_backend.exchange.solve_settings import SolveSettings
from supply.settings_page import settings_page


def test_the_page_lists_every_setting() -> None:
    page = settings_page()
    assert all(f"| `{name}` |" in page for name in SolveSettings.__dataclass_fields__)
    assert all(f"| `{name}` |" in page for name in READING_ROWS)
