"""Measure a child process's memory, using /proc on Linux, ``ps`` on macOS and BSD, and the Windows API."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path

_PROCESSES = Path("/proc")
_MB = 2**20
"""Bytes per megabyte."""
_KB_PER_MB = 2**10  # Binary units.
_QUERY = 0x1000  # PROCESS_QUERY_LIMITED_INFORMATION
_ASK_S = 5.0  # Seconds to wait for ``ps``. Chosen by hand.


def resident_mb(pid: int) -> float | None:
    """Return a process's memory in megabytes, 0 if it has ended, or None if the system does not report it."""
    if sys.platform == "win32":
        return _windows_mb(pid)
    if (_PROCESSES / "self" / "statm").is_file():
        try:
            pages = (_PROCESSES / str(pid) / "statm").read_text().split()[1]
        except (OSError, IndexError):
            return 0.0
        return int(pages) * os.sysconf("SC_PAGE_SIZE") / _MB
    try:
        asked = subprocess.run(
            ["ps", "-o", "rss=", "-p", str(pid)], capture_output=True, text=True, check=False, timeout=_ASK_S
        )
        return int(asked.stdout.strip() or 0) / _KB_PER_MB
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None


class _Counters(ctypes.Structure):
    """PROCESS_MEMORY_COUNTERS (Windows API, psapi.h)."""

    _fields_ = (
        ("size", ctypes.c_uint32), ("faults", ctypes.c_uint32), ("peak_working_set", ctypes.c_size_t),
        ("working_set", ctypes.c_size_t), ("pools", ctypes.c_size_t * 4), ("committed", ctypes.c_size_t),
        ("peak_committed", ctypes.c_size_t),
    )  # fmt: skip


def _windows_mb(pid: int) -> float | None:
    kernel = ctypes.WinDLL("kernel32")  # type: ignore[attr-defined]
    kernel.OpenProcess.restype = ctypes.c_void_p
    handle = kernel.OpenProcess(_QUERY, False, pid)
    if not handle:
        return 0.0
    counters = _Counters(size=ctypes.sizeof(_Counters))
    found = kernel.K32GetProcessMemoryInfo(ctypes.c_void_p(handle), ctypes.byref(counters), counters.size)
    kernel.CloseHandle(ctypes.c_void_p(handle))
    return counters.working_set / _MB if found else None
