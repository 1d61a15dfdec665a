"""Store diagnostics and provenance as texts in a .blend file."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from .._exchange.diagnostics import Diagnostic, read_diagnostics


def findings_text(found: Iterable[Diagnostic]) -> str:
    """Return diagnostics as JSON text, which ``findings_in`` reads back."""
    import json  # a bare Blender has not loaded it when add-ons are registered

    return json.dumps([item.as_dict() for item in found])


def value_in(provenance: str, *keys: str) -> Any:
    """Return a value in a motion's provenance (JSON text), None if there is none."""
    import json

    try:
        value = json.loads(provenance)
        for key in keys:
            value = value[key]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return value


@lru_cache(maxsize=32)  # panels ask at every redraw
def findings_in(text: str) -> tuple[Diagnostic, ...]:
    """Return the diagnostics of a text of ``findings_text``. Any other text has none."""
    import json

    try:
        return read_diagnostics(json.loads(text))
    except (ValueError, RecursionError):
        return ()
