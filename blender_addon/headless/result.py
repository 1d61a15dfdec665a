"""Results of this command line's verbs."""

from __future__ import annotations

from typing import Any

from .._exchange.errors import MocapError

CommandResult = dict[str, Any]
"""The ``result`` event: the written files as ``outputs``, sentences for people as ``notes``, an ``exit_code`` and a
``table`` to print where there are any, and values for programs."""


def failure(kind: str, name: str, error: MocapError) -> dict[str, Any]:
    """Return the record of a skipped clip or target (the kind)."""
    return {kind: name, "code": error.code, "message": str(error), "exit_code": error.exit_code}


def failure_notes(kind: str, failed: list[dict[str, Any]]) -> list[str]:
    """Return a sentence about each skipped clip or target."""
    return [f"{entry[kind]} failed: {entry['message']}" for entry in failed]
