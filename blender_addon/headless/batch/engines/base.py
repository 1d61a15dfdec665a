"""Interface of the engines that process takes, and two engines that do not need a cluster."""

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
    """A take that waits to be processed, and its earlier attempts."""

    capture: Path  # File or folder.
    name: str  # Name of the take.
    tries: int = 0  # Number of attempts whose failure may have been the worker's fault.
    avoid: set[str] = field(default_factory=set)  # Workers on which this take has failed.


@dataclass(frozen=True)
class Ended:
    """A take that an engine has processed or lost."""

    ticket: Ticket
    how: str  # ENDED (see the record), DIED (the take ended its workers) or LOST (unknown, to be started again).
    record: TakeRecord | None = None  # Record of the take if its status is ENDED.
    worker: str = ""


class Engine(Protocol):
    """Interface of the engines that process the takes of a batch, possibly several at a time."""

    tries: int  # Number of attempts at a take before it is set aside.

    def free(self) -> int:
        """Return the number of takes that the engine can start now."""
        ...

    def begin(self, ticket: Ticket) -> None:
        """Start the processing of a take."""

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return the takes that have ended. Wait for at most ``timeout_s`` seconds."""
        ...

    def notes(self) -> list[str]:
        """Return notes about the workers, for the user."""
        return []

    def headline(self) -> str:
        """Return a short description of the workers."""
        ...

    def close(self) -> None:
        """Stop all running takes, and release the workers."""
        return


class HereEngine(Engine):
    """An engine that processes one take at a time and runs Blender's part in this process."""

    tries = 1

    def __init__(self, work: Work, progress: Progress) -> None:
        self._work, self._progress = work, progress
        self._begun: Ticket | None = None

    def free(self) -> int:
        """Return 1 if no take is being processed, or else 0."""
        return int(self._begun is None)

    def begin(self, ticket: Ticket) -> None:
        """Store the take. ``ended`` will process it."""
        self._begun = ticket

    def ended(self, timeout_s: float) -> list[Ended]:
        """Process the take that ``begin`` stored, and return it."""
        ticket, self._begun = self._begun, None
        if ticket is None:
            time.sleep(timeout_s)
            return []
        return [Ended(ticket, ENDED, run_take(self._work, ticket.capture, self._progress))]

    def headline(self) -> str:
        """Return a short description of the workers."""
        return "this process"


class ProcessesEngine(Engine):
    """An engine that processes several takes at a time, each in its own solver and Blender processes."""

    tries = 2

    def __init__(self, work: Work, workers: int) -> None:
        self._work, self._workers = work, workers
        self._pool = ThreadPoolExecutor(workers, "take")
        self._running: dict[Future[TakeRecord], Ticket] = {}
        self._stop = threading.Event()

    def free(self) -> int:
        """Return the number of idle workers."""
        return self._workers - len(self._running)

    def begin(self, ticket: Ticket) -> None:
        """Start the processes for the take."""
        place = {"worker": "this machine", "stopped": self._stopped, "in_child": True}
        self._running[self._pool.submit(run_take, self._work, ticket.capture, silent, **place)] = ticket

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return the takes that have ended. Wait for at most ``timeout_s`` seconds."""
        if not self._running:
            self._stop.wait(timeout_s)
            return []
        done, _ = wait(self._running, timeout_s, FIRST_COMPLETED)
        return [Ended(self._running.pop(task), ENDED, task.result(), "this machine") for task in done]

    def headline(self) -> str:
        """Return a short description of the workers."""
        return f"{self._workers} processes"

    def close(self) -> None:
        """End all processes. The next batch starts unfinished takes again."""
        self._stop.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _stopped(self) -> MocapError | None:
        return Cancelled("The batch was cancelled.") if self._stop.is_set() else None
