"""Settings of a solve by their purpose."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "FAST": {"method": "bundle", "refine": False, "iterations": 5},
    "BALANCED": {},
    "BEST": {"method": "bundle", "refine": True, "refine_window": 5, "iterations": 16},
}
"""What each preset changes in the solver's own defaults."""
