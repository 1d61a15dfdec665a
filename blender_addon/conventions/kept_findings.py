"""Store diagnostics and provenance as text in a .blend file."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from .._exchange.diagnostics import Diagnostic, read_diagnostics


def findings_text(found: Iterable[Diagnostic]) -> str:
    """Convert diagnostics to JSON text. ``findings_in`` reads it back."""
    import json  # registering must not load JSON

    return json.dumps([item.as_dict() for item in found])


def value_in(provenance: str, *keys: str) -> Any:
    """Return a value from a motion's provenance (JSON text), or None if it is missing."""
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
    """Return the diagnostics in JSON text written by ``findings_text``, or none for any other text."""
    import json

    try:
        return read_diagnostics(json.loads(text))
    except (ValueError, RecursionError):
        return ()
