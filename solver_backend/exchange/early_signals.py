"""Handle Ctrl-C while a program loads its libraries, with the same named error as afterwards."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

CANCELLED = 130  # Exit code (128 + SIGINT, as in shells).
_MESSAGE, _HINT = "The work was cancelled.", "No incomplete file remains."
_EVENT = f'{{"event": "error", "code": "cancelled", "message": "{_MESSAGE}", "where": "", "hint": "{_HINT}"}}'
"""Event text, written without ``json``, which is not yet imported when Blender registers add-ons."""


def end_by_signals() -> None:
    """End the process with an error event if a signal arrives before a verb handles signals.

    The process ends immediately, because an exception could interrupt the import of a library. At this time, no output
    file is open.
    """
    for name in ("SIGINT", "SIGTERM", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _end)


def _end(number: int, frame: FrameType | None) -> None:
    as_json = "--json" in sys.argv
    text = _EVENT if as_json else f"error: {_MESSAGE}\n  try:   {_HINT}"
    os.write(1 if as_json else 2, f"{text}\n".encode())
    os._exit(CANCELLED)
