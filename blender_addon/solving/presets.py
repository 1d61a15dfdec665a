"""Settings of a solve by their purpose. ``dev.py bench presets`` measures their costs and accuracy."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "FAST": {"refine_window": 20, "iterations": 2, "learn_noise": False},
    "BALANCED": {},
    "BEST": {"refine_window": 8, "iterations": 60, "robust_scale": 5.0},
}
"""Changes of each preset to the solver's defaults."""
