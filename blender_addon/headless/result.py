"""Results of this command line's verbs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._exchange.errors import MocapError, OutputExists

CommandResult = dict[str, Any]
"""The ``result`` event. It contains the written files as ``outputs``, sentences for the user as ``notes``, values for
programs, and optionally an ``exit_code`` and a ``table`` to print."""


def failure(kind: str, name: str, error: MocapError) -> dict[str, Any]:
    """Return the record of a failed clip or target (``kind``)."""
    return {kind: name, "code": error.code, "message": str(error), "exit_code": error.exit_code}


def failure_notes(kind: str, failed: list[dict[str, Any]]) -> list[str]:
    """Return one sentence per failed clip or target."""
    return [f"{entry[kind]} failed: {entry['message']}" for entry in failed]


def refuse_replacing(paths: Sequence[Path], source: Path, *, overwrite: bool) -> None:
    """Raise ``OutputExists`` if an output would replace the source or another existing file."""
    there = [path for path in paths if path.exists()]
    own = [path for path in there if path.samefile(source) or path.resolve().parent == source.resolve()]
    if refused := own if overwrite else there:
        hint = "Choose another folder." if overwrite else "Choose another folder, or allow overwriting (--overwrite)."
        message = f"{', '.join(path.name for path in refused[:3])} would be overwritten."
        raise OutputExists(message, where=str(paths[0].parent), hint=hint)
