"""The end of a process that has used Blender as a module."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import NoReturn


def leave(code: int) -> NoReturn:
    """End the process with an exit code, at once where Blender is loaded.

    Blender as a module waits for ever at Python's end where a scene had a driver in Python: it frees the driver after
    the interpreter that compiled it (seen with bpy 4.5). Everything is written by then, so nothing else is to be done.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    if "bpy" in sys.modules:
        os._exit(code)
    sys.exit(code)
