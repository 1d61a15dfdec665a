"""Which tests run by default: those of what a user runs; the others with ``--all``, or where their file is named."""

from __future__ import annotations

from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parents[1]
AREAS = ("assets_procedural", "benchmarks", "kills", "research", "training")
"""Folders of what makes the files and tables that are committed: no user runs it."""


def left_out(config: pytest.Config, items: list[pytest.Item]) -> list[pytest.Item]:
    """Return the tests that this call leaves out: of an area or marked slow, and not asked for."""
    if config.getoption("--all"):
        return []
    named = [(config.invocation_params.dir / argument.split("::")[0]).resolve() for argument in config.args]
    return [item for item in items if _is_left_out(item, named)]


def _is_left_out(item: pytest.Item, named: list[Path]) -> bool:
    if item.path in named:
        return False
    area = next((TESTS / name for name in AREAS if item.path.is_relative_to(TESTS / name)), None)
    in_area = area is not None and not any(path.is_relative_to(area) for path in named)
    return in_area or item.get_closest_marker("slow") is not None
