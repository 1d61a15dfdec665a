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
    named = _named(config)
    areas = {path: is_left_out(config, path) for path in {item.path for item in items}}
    unnamed = [item for item in items if item.path not in named]
    return [item for item in unnamed if areas[item.path] or item.get_closest_marker("slow") is not None]


def is_left_out(config: pytest.Config, path: Path) -> bool:
    """Return whether a folder or file belongs to an area that this call does not ask for: nobody imports it then."""
    area = next((TESTS / name for name in AREAS if path.is_relative_to(TESTS / name)), None)
    if area is None or config.getoption("--all"):
        return False
    return not any(named.is_relative_to(area) for named in _named(config))


def _named(config: pytest.Config) -> list[Path]:
    """Return the files and folders that were asked for."""
    return [(config.invocation_params.dir / argument.split("::")[0]).resolve() for argument in config.args]
