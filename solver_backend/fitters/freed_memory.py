"""Memory that a stage of a long take has freed goes back to the system."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from typing import Any


def give_back_freed_memory() -> None:
    """Return free pages to the system: glibc keeps what threads have freed, gigabytes on long takes; elsewhere nothing.

    Reference: malloc_trim(3), Linux.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Any:
    if not sys.platform.startswith("linux"):
        return None
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):  # another library of C
        return None
