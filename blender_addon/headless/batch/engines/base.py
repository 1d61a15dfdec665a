"""Engines that do the takes of a batch, and two engines that need no cluster."""

from __future__ import annotations

import threading
import time
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ...._exchange.errors import Cancelled, MocapError
from ...._exchange.progress import Progress, silent
from ..record import TakeRecord
from ..run_take import run_take
from ..work import Work

LOST, ENDED, DIED = "lost", "ended", "died"


@dataclass
class Ticket:
    """A take to process."""

    capture: Path  # File or folder.
    name: str  # Of the take.
    tries: int = 0  # Attempts that failed for a reason that may lie with the worker.
    avoid: set[str] = field(default_factory=set)  # Workers that have failed with it.


@dataclass(frozen=True)
class Ended:
    """A take that an engine has finished."""

    ticket: Ticket
    how: str  # ENDED: see the record. DIED: it has ended its workers. LOST: unknown, the take must be begun again.
    record: TakeRecord | None = None  # Of the take, if it ended.
    worker: str = ""


class Engine(Protocol):
    """Processes takes, possibly several at a time. Doing one twice does no harm."""

    tries: int  # Attempts at a take before it is set aside.

    def free(self) -> int:
        """Return the number of takes that it could begin now."""
        ...

    def begin(self, ticket: Ticket) -> None:
        """Begin a take."""

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return the takes that have ended. Wait this long for one at most."""
        ...

    def notes(self) -> list[str]:
        """Return notes about the workers for people."""
        return []

    def headline(self) -> str:
        """Return the workers in a few words."""
        ...

    def close(self) -> None:
        """End the running takes, and tidy up."""
        return


class HereEngine(Engine):
    """One take at a time, with Blender's part in this process."""

    tries = 1

    def __init__(self, work: Work, progress: Progress) -> None:
        self._work, self._progress = work, progress
        self._begun: Ticket | None = None

    def free(self) -> int:
        """Return 1 between two takes."""
        return int(self._begun is None)

    def begin(self, ticket: Ticket) -> None:
        """Keep the take for ``ended``, which does it."""
        self._begun = ticket

    def ended(self, timeout_s: float) -> list[Ended]:
        """Process the take that was begun."""
        ticket, self._begun = self._begun, None
        if ticket is None:
            time.sleep(timeout_s)
            return []
        return [Ended(ticket, ENDED, run_take(self._work, ticket.capture, self._progress))]

    def headline(self) -> str:
        """Return the workers in a few words."""
        return "this process"


class ProcessesEngine(Engine):
    """Several takes at a time, each with processes for its solver and Blender. Nothing has to be installed."""

    tries = 2

    def __init__(self, work: Work, workers: int) -> None:
        self._work, self._workers = work, workers
        self._pool = ThreadPoolExecutor(workers, "take")
        self._running: dict[Future[TakeRecord], Ticket] = {}
        self._stop = threading.Event()

    def free(self) -> int:
        """Return how many workers are idle."""
        return self._workers - len(self._running)

    def begin(self, ticket: Ticket) -> None:
        """Start the take's processes."""
        place = {"worker": "this machine", "stopped": self._stopped, "in_child": True}
        self._running[self._pool.submit(run_take, self._work, ticket.capture, silent, **place)] = ticket

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return the takes with processes that have ended."""
        if not self._running:
            self._stop.wait(timeout_s)
            return []
        done, _ = wait(self._running, timeout_s, FIRST_COMPLETED)
        return [Ended(self._running.pop(task), ENDED, task.result(), "this machine") for task in done]

    def headline(self) -> str:
        """Return the workers in a few words."""
        return f"{self._workers} processes"

    def close(self) -> None:
        """End all processes. The next batch begins unfinished takes again."""
        self._stop.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _stopped(self) -> MocapError | None:
        return Cancelled("The batch was cancelled.") if self._stop.is_set() else None
