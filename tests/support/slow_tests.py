"""Tests marked slow run with ``--all``, or where their own file is named."""

from __future__ import annotations

from pathlib import Path

import pytest


def left_out(config: pytest.Config, items: list[pytest.Item]) -> list[pytest.Item]:
    """Return the tests that this call leaves out."""
    if config.getoption("--all"):
        return []
    named = {Path(argument.split("::")[0]).name for argument in config.args}
    return [item for item in items if item.get_closest_marker("slow") and item.path.name not in named]
