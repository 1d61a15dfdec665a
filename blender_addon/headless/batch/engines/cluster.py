"""Takes done by the workers of a Dask cluster (Rocklin 2015): each step a task, each take a chain of them.

Dask places the tasks and repeats those of workers that have died. What it does not know is kept here: which workers can
do the takes at all, and that a take that failed is tried on another worker. State is in the takes' records alone, so a
scheduler, a worker or this program may end at any time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any

from ....errors import BatchTaken, EngineMissing, SchedulerMissing, WorkersUnsuitable
from ..request import BatchRequest
from ..steps import steps_of
from .base import DIED, ENDED, LOST, Ended, Ticket
from .marker import marker_in, put_marker, remove_marker

MEMORY = "memory_mb"
"""Resource of a worker, as ``dask worker --resources memory_mb=8000`` states it."""
_AHEAD = 2
"""Takes begun for each thread of the workers: one at work, one waiting."""
_LOOK_S = 1.0
_CONNECT_S = 10.0
_CLOCK_S = 60.0
"""Clocks that differ by more are told of."""
_FAILS = 3
"""A worker that fails with so many takes in a row, which others can do, gets no more."""


@dataclass
class _Running:
    ticket: Ticket
    futures: list[Any]
    last: Any
    allowed: set[str] | None


@dataclass
class _Workers:
    """What is known about the workers, by address."""

    bad: dict[str, str] = field(default_factory=dict)
    """Why a worker gets no takes."""
    fails: dict[str, int] = field(default_factory=dict)
    looked_at: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


class ClusterEngine:
    """Takes as chains of tasks on a cluster.

    Args:
        request: the batch; its folders must be the same to all workers.
        choices: what decides what is made of a capture.
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
        self, request: BatchRequest, choices: dict[str, Any], address: str,
        tend: Callable[[], None] = lambda: None, patience_s: float = 60.0, stretches: bool = False,
    ) -> None:  # fmt: skip
        _require_dask()
        from .cluster_task import versions

        self._request, self._choices, self._address, self._tend = request, choices, address, tend
        self._patience_s, self._stretches = patience_s, stretches
        self._versions = versions()
        self._running: dict[str, _Running] = {}
        self._queue: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._workers = _Workers()
        self._looked = 0.0
        self._without_workers: float | None = None
        self._client = _connected(address, patience_s=min(_CONNECT_S, patience_s), tend=tend)
        self._marker = put_marker(request.out)
        self._plain = request.plain()
        try:
            self._wait_for_workers()
        except BaseException:
            self.close()
            raise

    def free(self) -> int:
        """Return how many takes the workers' threads lack, one waiting for each beside the one at work."""
        threads = sum(info["nthreads"] for address, info in self._infos().items() if address not in self._workers.bad)
        return (1 if self._stretches else _AHEAD) * threads - len(self._running)

    def begin(self, ticket: Ticket) -> None:
        """Hand the take's steps to the scheduler."""
        from .cluster_task import step_of_take

        given = {
            "request": self._plain, "choices": self._choices, "marker": self._marker, "versions": self._versions,
            "capture": str(ticket.capture.resolve()), "stretches": self._stretches,
        }  # fmt: skip
        allowed = self._allowed(ticket)
        memory_mb = self._request.limits.memory_mb
        where: dict[str, Any] = {} if allowed is None else {"workers": sorted(allowed), "allow_other_workers": False}
        if memory_mb is not None and self._states_memory():
            where["resources"] = {MEMORY: memory_mb}
        futures: list[Any] = []
        name = f"{ticket.name}-{self._marker[:8]}-{time.monotonic_ns():x}"
        try:
            for step in steps_of(self._request, self._choices, ticket.capture):
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
        return [
            *self._workers.notes,
            *(f"Worker {name} gets no takes: {why}." for name, why in self._workers.bad.items()),
        ]

    def headline(self) -> str:
        """Return the number of workers and the dashboard's address."""
        link = ""
        with suppress(Exception):
            link = self._client.dashboard_link
        return f"{len(self._infos())} workers, dashboard {link}" if link else f"{len(self._infos())} workers"

    def close(self) -> None:
        """Withdraw what is being done; workers notice that within seconds."""
        remove_marker(self._request.out, self._marker)
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
            record = {"take": ticket.name, "capture": str(ticket.capture), "status": "failed"}
            error = {"code": "file_missing", "message": f"The capture cannot be read: {future}.", "exit_code": 3}
            return [Ended(ticket, ENDED, {**record, "error": error})]
        if future.status == "finished":
            try:
                result = future.result(timeout=_CONNECT_S)
            except Exception:  # it was lost between its end and now
                return [Ended(ticket, LOST)]
            return [self._judged(ticket, result)]
        if future.status == "error":
            error = future.exception(timeout=_CONNECT_S)
            if type(error).__name__ == "KilledWorker":
                return [Ended(ticket, DIED)]
            self._workers.note(f"A task of {ticket.name} broke: {type(error).__name__}: {error}.")
            ticket.tries += 1
            return [Ended(ticket, LOST if ticket.tries < self.tries else DIED)]
        return [Ended(ticket, LOST)]

    def _judged(self, ticket: Ticket, result: dict[str, Any]) -> Ended:
        worker = result["worker"]
        if "unsuitable" in result:
            self._workers.bad[worker] = result["unsuitable"]
            return Ended(ticket, LOST)
        record = result["record"]
        if (record.get("error") or {}).get("code") == "output_not_writable":
            fails = self._workers.fails[worker] = self._workers.fails.get(worker, 0) + 1
            self._workers.note(f"Worker {worker} could not write: {record['error']['message']}")
            if fails >= _FAILS and len(self._good()) > 1:
                self._workers.bad[worker] = f"it could not write {fails} takes in a row"
        else:
            self._workers.fails.pop(worker, None)
        return Ended(ticket, ENDED, record, worker)

    def _look(self) -> list[Ended]:
        """Look after scheduler, workers and marker; return the takes that nobody will do."""
        self._tend()
        if self._client.status != "running":
            return self._begin_anew()
        if marker_in(self._request.out) not in (self._marker, ""):
            raise BatchTaken(
                "Another batch has begun in the same folder of results.", where=str(self._request.out),
                hint="What is done is kept. Give each batch its own --out, or wait for the other one.",
            )  # fmt: skip
        self._look_at_new_workers()
        live = set(self._infos())
        stuck = [
            name
            for name, one in self._running.items()
            if one.last is None or (one.allowed is not None and not one.allowed & live)
        ]
        self._check_for_workers()
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
        self._client = _connected(self._address, self._patience_s, self._tend)
        self._workers.looked_at.clear()

    def _infos(self) -> dict[str, Any]:
        try:
            return dict(self._client.scheduler_info(n_workers=-1)["workers"])
        except Exception:  # the connection is going down; the next look says so
            return {}

    def _good(self) -> set[str]:
        return set(self._infos()) - set(self._workers.bad)

    def _allowed(self, ticket: Ticket) -> set[str] | None:
        """Return the workers that may do a take, None for all."""
        good = self._good()
        others = good - ticket.avoid
        if not self._workers.bad and others == good:
            return None
        return others or good

    def _states_memory(self) -> bool:
        """Return whether workers say how much memory their takes may have.

        Raises:
            WorkersUnsuitable: no worker has as much as a take may take.
        """
        stated = [info.get("resources", {}).get(MEMORY) for info in self._infos().values()]
        amounts = [amount for amount in stated if amount is not None]
        wanted = self._request.limits.memory_mb or 0.0
        if amounts and max(amounts) < wanted:
            raise WorkersUnsuitable(
                f"No worker has the {wanted:g} MB that a take may take; the largest has {max(amounts):g} MB.",
                where=self._address, hint="Lower --take-memory, or start workers with more.",
            )  # fmt: skip
        return bool(amounts) and len(amounts) == len(stated)

    def _look_at_new_workers(self) -> None:
        from .cluster_task import describe, what_is_wrong

        out = self._plain["out"]
        new = sorted(set(self._infos()) - self._workers.looked_at)
        if not new:
            return
        try:
            asked = time.time()
            found = self._client.run(describe, out, workers=new, on_error="return")
        except Exception:  # a worker that has just died is looked at no more, the others the next time
            return
        self._workers.looked_at.update(new)
        for worker, about in found.items():
            if isinstance(about, BaseException):
                if isinstance(about, ImportError):
                    self._workers.bad[worker] = f"Manifold MoCap cannot be imported there ({about})"
                continue
            if wrong := what_is_wrong(about, self._versions, self._marker, out):
                self._workers.bad[worker] = wrong
            ahead_s = about["time"] - asked
            if abs(ahead_s) > _CLOCK_S:
                self._workers.note(
                    f"The clock of {about['host']} differs by {ahead_s:+.0f} s; nothing depends on it but the "
                    "times of files."
                )

    def _wait_for_workers(self) -> None:
        end = time.monotonic() + self._patience_s
        while time.monotonic() < end and not self._infos():
            self._tend()
            if self._client.status != "running":
                self._connect_again()
            time.sleep(0.2)
        self._look_at_new_workers()
        self._without_workers = None
        self._check_for_workers(patience_s=0.0)

    def _check_for_workers(self, patience_s: float | None = None) -> None:
        """Raise where there has been no worker for too long, or none that could do takes."""
        if self._good():
            self._without_workers = None
            return
        now = time.monotonic()
        self._without_workers = self._without_workers or now
        if now - self._without_workers < (self._patience_s if patience_s is None else patience_s):
            return
        reasons = "; ".join(f"{worker}: {why}" for worker, why in list(self._workers.bad.items())[:3])
        raise WorkersUnsuitable(
            f"No worker can do the takes: {reasons}." if reasons else "The scheduler has no workers.",
            where=self._address,
            hint="Workers need the same version, the same Python and the same folders as this program, under the same "
            "paths. Finished takes are kept." if reasons else "Start some: dask worker ADDRESS --nthreads 1.",
        )  # fmt: skip


def _require_dask() -> None:
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise EngineMissing(
            "Dask is not installed in this Python.", where=str(error),
            hint="pip install 'manifold-mocap[scale]'; or leave out --scheduler and give --workers N.",
        ) from error  # fmt: skip


def _connected(address: str, patience_s: float, tend: Callable[[], None]) -> Any:
    """Return a client of a scheduler.

    Raises:
        SchedulerMissing: none answers for so long.
    """
    import logging

    from distributed import Client

    for name in ("distributed", "distributed.client", "distributed.comm", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    end, where = time.monotonic() + patience_s, {"address": address}
    if address.endswith(".json"):
        where = {"scheduler_file": address}
    while True:
        tend()
        try:
            return Client(**where, timeout=min(5.0, patience_s), set_as_default=False)
        except Exception as error:  # of the network, of the protocol, of another version's messages
            if time.monotonic() > end:
                raise SchedulerMissing(
                    f"No scheduler answers: {type(error).__name__}: {error}.", where=address,
                    hint="Start one with 'dask scheduler' and give its address, such as tcp://10.0.0.5:8786; it must "
                    "have this program's version of Dask. Finished takes are kept.",
                ) from error  # fmt: skip
            time.sleep(0.5)
