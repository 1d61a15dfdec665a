"""Settings of a solve by their purpose."""

from __future__ import annotations

from typing import Any

PRESETS: dict[str, dict[str, Any]] = {
    "FAST": {"iterations": 3},
    "BALANCED": {},
    "BEST": {"iterations": 20},
}
"""What each preset changes in the solver's own defaults."""
