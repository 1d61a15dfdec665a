"""Handle Ctrl-C while a program loads its libraries, with the same named error as later."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

CANCELLED = 130  # Exit code (128 + SIGINT, as shells have it).
_MESSAGE, _HINT = "The work was cancelled.", "Nothing was left half-written."
_EVENT = f'{{"event": "error", "code": "cancelled", "message": "{_MESSAGE}", "where": "", "hint": "{_HINT}"}}'
"""Written without ``json``, which a bare Blender has not loaded when add-ons are registered."""


def end_by_signals() -> None:
    """End the process at once at a signal, with one error event or sentence, until a verb handles signals itself.

    No file is open by then, and an exception could come out of the middle of a library's import.
    """
    for name in ("SIGINT", "SIGTERM", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _end)


def _end(number: int, frame: FrameType | None) -> None:
    as_json = "--json" in sys.argv
    text = _EVENT if as_json else f"error: {_MESSAGE}\n  try:   {_HINT}"
    os.write(1 if as_json else 2, f"{text}\n".encode())
    os._exit(CANCELLED)
