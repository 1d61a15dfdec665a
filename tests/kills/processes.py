"""The processes that a program has started, wherever their parents are by now. Linux alone: read from /proc."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

MARK = "MANIFOLD_MOCAP_TEST_KILLED_IN"
"""Variable of the environment that names the folder of the killed operation; children inherit it."""
_PATIENCE_S, _LOOK_S = 60.0, 0.1
"""What is left ends by itself within so long; workers look for their parent only now and then."""


def wait_for_the_end(folder: str) -> list[str]:
    """Wait until an operation's processes have ended; return the commands of those that had to be killed.

    Args:
        folder: of the operation.
    """
    end = time.monotonic() + _PATIENCE_S
    while (left := marked(folder)) and time.monotonic() < end:
        time.sleep(_LOOK_S)
    for pid in left:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return list(left.values())


def marked(folder: str) -> dict[int, str]:
    """Return the command of every running process whose environment names the folder, by its number."""
    wanted, found = f"{MARK}={folder}".encode(), {}
    for place in Path("/proc").iterdir():
        with suppress(OSError):
            if place.name.isdigit() and wanted in (place / "environ").read_bytes().split(b"\0"):
                words = (place / "cmdline").read_bytes().split(b"\0")
                found[int(place.name)] = b" ".join(words).decode("utf-8", "replace")[:200]
    return found
