"""CPU time of a process and of the processes of its group. Linux alone: read from /proc."""

from __future__ import annotations

import os
from pathlib import Path

TICKS_A_SECOND = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


def cpu_of(group: int) -> float:
    """Return the CPU seconds of all processes of a group, those that have ended and were waited for with them."""
    return sum(sum(map(int, fields[11:15])) for fields in _of_group(group)) / TICKS_A_SECOND


def states_of(group: int) -> str:
    """Return a letter for each process of a group: R running, S sleeping, Z ended but not waited for, ..."""
    return "".join(fields[0] for fields in _of_group(group))


def _of_group(group: int) -> list[list[str]]:
    """Return the fields behind the name (``man proc``) of every process of a group."""
    found = []
    for place in Path("/proc").iterdir():
        if not place.name.isdigit():
            continue
        try:
            fields = (place / "stat").read_text("ascii", "replace").rpartition(")")[2].split()
        except OSError:  # it has ended meanwhile
            continue
        if int(fields[2]) == group:
            found.append(fields)
    return found
