"""How long and how much memory the solver may take for one take of a batch."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from ..._exchange.errors import MocapError
from ...errors import BatchInvalid, TakeTooLarge, TakeTooSlow

_PROCESSES = Path("/proc")
_MB = 2**20
"""Bytes."""


@dataclass(frozen=True)
class TakeLimits:
    """Limits of the solver for one take; None is none."""

    seconds: float | None = None
    """Of reading and solving together."""
    memory_mb: float | None = None
    """Of the solver's process, resident."""

    def require_possible(self) -> None:
        """Make sure that the limits can be held here.

        Raises:
            BatchInvalid: this system does not report a process's memory.
        """
        if self.memory_mb is not None and not _PROCESSES.is_dir():
            raise BatchInvalid(
                "This system does not report a process's memory.",
                hint="Leave out --take-memory, or run the batch on Linux.",
            )


class TakeWatch:
    """Watches the processes of one take, from its start on."""

    def __init__(self, limits: TakeLimits) -> None:
        self._limits, self._start = limits, time.monotonic()

    def over_limit(self, pid: int) -> MocapError | None:
        """Return the error of a process that is beyond a limit, None as long as it is within."""
        seconds, most_mb = self._limits.seconds, self._limits.memory_mb
        if seconds is not None and time.monotonic() - self._start > seconds:
            return TakeTooSlow(
                f"The take took longer than {seconds:g} s and was stopped.",
                hint="Raise --take-seconds, or solve the take alone.",
            )
        if most_mb is not None and (used_mb := _resident_mb(pid)) > most_mb:
            return TakeTooLarge(
                f"The solver took {used_mb:.0f} MB for the take, more than the {most_mb:g} MB it may have, and was "
                "stopped.",
                hint="Raise --take-memory, or cut the take.",
            )
        return None


def _resident_mb(pid: int) -> float:
    """Return the memory that a process has in RAM; 0 where it has ended."""
    try:
        pages = (_PROCESSES / str(pid) / "statm").read_text().split()[1]
    except (OSError, IndexError):
        return 0.0
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / _MB
