"""Settings of a solve by their purpose."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "FAST": {"refine": False},
    "BALANCED": {},
    "BEST": {"window": 10, "iterations": 16},
}
"""What each preset changes in the solver's own defaults."""
