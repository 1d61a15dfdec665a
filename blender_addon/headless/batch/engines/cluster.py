"""Takes done by the workers of a Dask cluster (Rocklin 2015): each step a task, each take a chain of them.

Dask places the tasks and repeats those of workers that have died. What it does not know is kept here: which workers can
do the takes at all, and that a take that failed is tried on another worker. State is in the takes' records alone, so a
scheduler, a worker or this program may end at any time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from ....errors import BatchTaken
from ..record import Failure, begun_record, read_record
from ..work import Work
from .base import DIED, ENDED, LOST, Ended, Ticket
from .connection import connected, require_dask
from .marker import marker_in, put_marker, remove_marker

if TYPE_CHECKING:
    from .cluster_task import Batch, TaskResult

_AHEAD = 2
"""Takes begun for each thread of the workers: one at work, one waiting."""
_LOOK_S = 1.0
_CONNECT_S = 10.0
"""Seconds within which a scheduler answers; chosen by hand."""


@dataclass
class _Running:
    ticket: Ticket
    futures: list[Any]
    last: Any
    allowed: set[str] | None


class ClusterEngine:
    """Takes as chains of tasks on a cluster.

    Args:
        work: the batch; its folders must be the same to all workers.
        address: of the scheduler, or the name of its file.
        tend: called now and then, by a cluster of our own to start again what has died.
        patience_s: how long to wait for a scheduler that is gone, and for workers.
        stretches: let workers solve stretches of long takes, too.

    Raises:
        EngineMissing: Dask is not installed.
        SchedulerMissing: no scheduler answers.
        WorkersUnsuitable: there are no workers, or none that could do takes; the first reason is named.
    """

    tries = 3

    def __init__(
        self, work: Work, address: str,
        tend: Callable[[], None] = lambda: None, patience_s: float = 60.0, stretches: bool = False,
    ) -> None:  # fmt: skip
        require_dask()
        from .cluster_workers import Workers

        self._work, self._address, self._tend = work, address, tend
        self._patience_s, self._stretches = patience_s, stretches
        self._running: dict[str, _Running] = {}
        self._queue: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._looked = 0.0
        self._client = connected(address, patience_s=min(_CONNECT_S, patience_s), tend=tend)
        self._marker = put_marker(work.out)
        self._plain, self._out = work.plain(), str(work.out.resolve())
        self._workers = Workers(address, self._out, self._marker, patience_s)
        self._workers.client = self._client
        try:
            self._wait_for_workers()
        except BaseException:
            self.close()
            raise

    def free(self) -> int:
        """Return how many takes the workers' threads lack, one waiting for each beside the one at work."""
        return (1 if self._stretches else _AHEAD) * self._workers.threads - len(self._running)

    def begin(self, ticket: Ticket) -> None:
        """Hand the take's steps to the scheduler."""
        from .cluster_task import step_of_take
        from .cluster_workers import MEMORY

        given: Batch = {
            "work": self._plain, "out": self._out, "capture": str(ticket.capture.resolve()),
            "marker": self._marker, "versions": self._workers.versions, "stretches": self._stretches,
        }  # fmt: skip
        allowed = self._workers.allowed(ticket)
        memory_mb = self._work.limits.memory_mb
        where: dict[str, Any] = {} if allowed is None else {"workers": sorted(allowed), "allow_other_workers": False}
        if memory_mb is not None and self._workers.state_memory(memory_mb):
            where["resources"] = {MEMORY: memory_mb}
        futures: list[Any] = []
        name = f"{ticket.name}-{self._marker[:8]}-{time.monotonic_ns():x}"
        try:
            for step in self._work.steps(ticket.capture):
                before = futures[-1] if futures else None
                key = f"{step.name}-{step.key[:16]}-{name}"
                futures.append(
                    self._client.submit(step_of_take, given, step.name, before, key=key, pure=False, **where)
                )
        except OSError as error:
            self._queue.put((name, error))
            self._running[name] = _Running(ticket, [], None, None)
            return
        except Exception as error:  # the scheduler went away just now
            self._workers.note(f"The scheduler was lost: {error}.")
            self._running[name] = _Running(ticket, futures, None, allowed)
            return
        self._running[name] = _Running(ticket, futures, futures[-1], allowed)
        futures[-1].add_done_callback(lambda future, name=name: self._queue.put((name, future)))

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return the takes whose last step has ended; those of a scheduler that is gone are lost."""
        found: list[Ended] = []
        with suppress(Empty):
            found += self._ended_of(*self._queue.get(timeout=timeout_s))
            while True:
                found += self._ended_of(*self._queue.get_nowait())
        if time.monotonic() - self._looked > _LOOK_S:
            self._looked = time.monotonic()
            found += self._look()
        return found

    def notes(self) -> list[str]:
        """Return which workers get no takes and why, and whose clocks differ."""
        return self._workers.notes

    def headline(self) -> str:
        """Return the number of workers and the dashboard's address."""
        link = ""
        with suppress(Exception):
            link = self._client.dashboard_link
        return (
            f"{len(self._workers.infos())} workers, dashboard {link}"
            if link
            else f"{len(self._workers.infos())} workers"
        )

    def close(self) -> None:
        """Withdraw what is being done; workers notice that within seconds."""
        remove_marker(self._work.out, self._marker)
        with suppress(Exception):
            self._client.cancel([future for one in self._running.values() for future in one.futures])
        with suppress(Exception):
            self._client.close(timeout=5)

    def _ended_of(self, name: str, future: Any) -> list[Ended]:
        one = self._running.pop(name, None)
        if one is None:
            return []
        ticket = one.ticket
        if isinstance(future, OSError):
            why: Failure = {
                "code": "file_missing", "message": f"The capture cannot be read: {future}.", "exit_code": 3,
            }  # fmt: skip
            record = begun_record(ticket.name, ticket.capture)
            return [Ended(ticket, ENDED, {**record, "status": "failed", "error": why})]
        if future.status == "finished":
            try:
                result = future.result(timeout=_CONNECT_S)
            except Exception:  # it was lost between its end and now
                return [Ended(ticket, LOST)]
            return [self._ended(ticket, result)]
        if future.status == "error":
            error = future.exception(timeout=_CONNECT_S)
            if type(error).__name__ == "KilledWorker":
                return [Ended(ticket, DIED if self._deaths(ticket) >= self.tries else LOST)]
            self._workers.note(f"A task of {ticket.name} failed: {type(error).__name__}: {error}.")
            ticket.tries += 1
            return [Ended(ticket, LOST if ticket.tries < self.tries else DIED)]
        return [Ended(ticket, LOST)]

    def _deaths(self, ticket: Ticket) -> int:
        """Return how often a take was begun and never ended; Dask also blames those that waited behind it."""
        known = read_record(self._work.out / ticket.name)
        attempts = () if known is None else known.get("attempts", ())
        return sum(attempt["how"] == "begun" for attempt in attempts)

    def _ended(self, ticket: Ticket, result: TaskResult) -> Ended:
        worker = result["worker"]
        if "record" not in result:
            self._workers.bad[worker] = result.get("unsuitable", "")
            return Ended(ticket, LOST)
        record = result["record"]
        error = record.get("error")
        unwritable = error is not None and error["code"] == "output_not_writable"
        self._workers.wrote(worker, error["message"] if error and unwritable else "")
        return Ended(ticket, ENDED, record, worker)

    def _look(self) -> list[Ended]:
        """Look after scheduler, workers and marker; return the takes that nobody will do."""
        self._tend()
        if self._client.status != "running":
            return self._begin_anew()
        if marker_in(self._work.out) not in (self._marker, ""):
            raise BatchTaken(
                "Another batch has begun in the same folder of results.", where=str(self._work.out),
                hint="What is done is kept. Give each batch its own --out, or wait for the other one.",
            )  # fmt: skip
        self._workers.look_at_new()
        live = set(self._workers.infos())
        stuck = [
            name
            for name, one in self._running.items()
            if one.last is None or (one.allowed is not None and not one.allowed & live)
        ]
        self._workers.require_some()
        return [self._released(name) for name in stuck]

    def _released(self, name: str) -> Ended:
        one = self._running.pop(name)
        with suppress(Exception):
            self._client.cancel(one.futures)
        return Ended(one.ticket, LOST)

    def _begin_anew(self) -> list[Ended]:
        """Connect again after the scheduler was lost, and return what it had."""
        self._workers.note("The scheduler was lost and came back; what it had was begun again.")
        lost = [Ended(one.ticket, LOST) for one in self._running.values()]
        self._running.clear()
        self._connect_again()
        self._wait_for_workers()
        return lost

    def _connect_again(self) -> None:
        with suppress(Exception):
            self._client.close(timeout=2)
        self._workers.client = self._client = connected(self._address, self._patience_s, self._tend)
        self._workers.forget_looks()

    def _wait_for_workers(self) -> None:
        end = time.monotonic() + self._patience_s
        while time.monotonic() < end and not self._workers.infos():
            self._tend()
            if self._client.status != "running":
                self._connect_again()
            time.sleep(0.2)
        self._workers.look_at_new()
        self._workers.require_some(patience_s=0.0)
