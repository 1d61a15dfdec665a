"""Process takes on a Dask cluster (Rocklin 2015), with one task per step.

Dask schedules tasks, and repeats the tasks of workers that have died. This module selects suitable workers and retries
failed takes on other workers. The takes' records store all state, so scheduler, workers and program may end any time.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from ...._exchange.cluster_address import require_certificates, require_safe
from ...._exchange.errors import FileMissing
from ....errors import BatchTaken, EngineMissing, SchedulerMissing, WorkersUnsuitable
from ..record import begun_record, failure_of, read_record
from ..work import Work
from .base import DIED, ENDED, LOST, Ended, Engine, Ticket
from .cluster_task import describe, marker_in, put_marker, remove_marker, versions, what_is_wrong

if TYPE_CHECKING:
    from .cluster_task import TaskResult


def require_dask() -> None:
    """Raise ``EngineMissing`` if Dask is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        hint = "Install it with: pip install distributed. Or use --workers N instead of --scheduler."
        raise EngineMissing("Dask is not installed in this Python.", where=str(error), hint=hint) from error


def connected(address: str, patience_s: float, tend: Callable[[], None]) -> Any:
    """Connect to a scheduler within ``patience_s`` seconds, and return the client. Call ``tend`` while waiting.

    Raises:
        SchedulerUnsafe: the scheduler is on another host without TLS, or TLS certificates are missing.
    """
    require_safe(address)
    import dask.config
    from distributed import Client

    require_certificates(address, dask.config.get("distributed.comm.tls.ca-file", None))
    for name in ("distributed", "distributed.client", "distributed.comm", "distributed.core"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    end = time.monotonic() + patience_s
    where: dict[str, Any] = {"scheduler_file" if address.endswith(".json") else "address": address}
    while True:
        tend()
        try:
            return Client(**where, timeout=min(5.0, patience_s), set_as_default=False)
        except Exception as error:  # errors of the network, the protocol, or another version's messages
            if time.monotonic() > end:
                raise SchedulerMissing(
                    f"No scheduler responds: {type(error).__name__}: {error}.",
                    where=address,
                    hint="Start one with 'dask scheduler' and set its address, such as tcp://10.0.0.5:8786. It must "
                    "have this program's version of Dask. Finished takes are kept.",
                ) from error
            time.sleep(0.5)


_AHEAD = 2  # Takes sent to each worker thread: one that runs and one that waits.
_LOOK_S = 1.0
_CONNECT_S = 10.0
"""Seconds to wait for the scheduler's answer. Chosen by hand."""


@dataclass
class _Running:
    ticket: Ticket
    futures: list[Any]
    last: Any
    allowed: set[str] | None


class ClusterEngine(Engine):
    """An engine that processes takes as chains of tasks on a cluster.

    Args:
        work: the batch. All workers must have access to the same folders.
        address: address of the scheduler, or path of its file.
        tend: function to call regularly. A local cluster uses it to restart processes that have died.
        patience_s: seconds to wait for a lost scheduler, and for workers.
        stretches: also let workers solve segments of long takes.

    Raises:
        WorkersUnsuitable: there are no workers, or none can process takes. The message contains the first reason.
    """

    tries = 3

    def __init__(
        self, work: Work, address: str, tend: Callable[[], None] | None, patience_s: float, stretches: bool
    ) -> None:
        require_dask()
        self._work, self._address = work, address
        self._tend = tend = tend or (lambda: None)
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
        """Return how many more takes the workers can receive, including takes that wait for a free thread."""
        return (1 if self._stretches else _AHEAD) * self._workers.threads - len(self._running)

    def begin(self, ticket: Ticket) -> None:
        """Send the steps of a take to the scheduler."""
        from .cluster_task import step_of_take

        capture, stretches = str(ticket.capture.resolve()), self._stretches
        marks = {"marker": self._marker, "versions": self._workers.versions}
        given: Any = {"work": self._plain, "out": self._out, "capture": capture, "stretches": stretches, **marks}
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
                words = (given, step.name, before)
                futures.append(self._client.submit(step_of_take, *words, key=key, pure=False, **where))
        except OSError as error:
            self._queue.put((name, error))
            self._running[name] = _Running(ticket, [], None, None)
            return
        except Exception as error:  # the scheduler has just disappeared
            self._workers.note(f"The scheduler was lost: {error}.")
            self._running[name] = _Running(ticket, futures, None, allowed)
            return
        self._running[name] = _Running(ticket, futures, futures[-1], allowed)
        futures[-1].add_done_callback(lambda future, name=name: self._queue.put((name, future)))

    def ended(self, timeout_s: float) -> list[Ended]:
        """Return the takes that have ended. A lost scheduler ends all takes that were running on it."""
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
        """Return notes about unsuitable workers and about differences between clocks."""
        return self._workers.notes

    def headline(self) -> str:
        """Return a text with the number of workers and the dashboard's address."""
        link = ""
        with suppress(Exception):
            link = self._client.dashboard_link
        return f"{len(self._workers.infos())} workers" + (f", dashboard {link}" if link else "")

    def close(self) -> None:
        """Withdraw all running takes. Workers notice this within seconds."""
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
            why = failure_of(FileMissing(f"The capture cannot be read: {future}."))
            record = begun_record(ticket.name, ticket.capture)
            return [Ended(ticket, ENDED, {**record, "status": "failed", "error": why})]
        if future.status == "finished":
            try:
                result = future.result(timeout=_CONNECT_S)
            except Exception:  # the connection was lost after it ended
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
        """Return how many attempts at a take began but did not end. Dask's count includes takes that only waited."""
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
        """Check the scheduler, the workers and the batch's marker file. Return the takes that were lost."""
        self._tend()
        if self._client.status != "running":
            return self._begin_anew()
        if marker_in(self._work.out) not in (self._marker, ""):
            hint = "Finished takes are kept. Give each batch its own --out, or wait for the other one."
            message = "Another batch is using the same results folder."
            raise BatchTaken(message, where=str(self._work.out), hint=hint)
        self._workers.look_at_new()
        live = set(self._workers.infos())
        running = self._running.items()
        stuck = [name for name, one in running if one.last is None or not (one.allowed is None or one.allowed & live)]
        self._workers.require_some()
        return [self._released(name) for name in stuck]

    def _released(self, name: str) -> Ended:
        one = self._running.pop(name)
        with suppress(Exception):
            self._client.cancel(one.futures)
        return Ended(one.ticket, LOST)

    def _begin_anew(self) -> list[Ended]:
        """Reconnect after the scheduler was lost, and return the takes that were running on it."""
        self._workers.note("The scheduler was lost and came back. Its takes were restarted.")
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


MEMORY = "memory_mb"  # Resource of a worker, as in ``dask worker --resources memory_mb=8000``.
_CLOCK_S = 60.0  # Workers whose clocks differ by more than this, in seconds, are reported.
_FAILS = 3  # Consecutive write failures after which a worker is no longer used if there are others.


class Workers:
    """The workers that a Dask scheduler knows: which of them are suitable, and why others are not."""

    def __init__(self, address: str, out: str, marker: str, patience_s: float) -> None:
        self._address, self._out, self._marker, self._patience_s = address, out, marker, patience_s
        self._fails: dict[str, int] = {}
        self._looked_at: set[str] = set()
        self._without: float | None = None
        self._notes: list[str] = []
        self.versions = versions()
        """Versions that every worker must have."""
        self.bad: dict[str, str] = {}
        """Unsuitable workers, and the reason for each."""
        self.client: Any = None
        """Client of the scheduler, or None before it is connected."""

    @property
    def notes(self) -> list[str]:
        """Notes for the user, including the reasons why workers get no takes."""
        return [*self._notes, *(f"Worker {name} gets no takes: {why}." for name, why in self.bad.items())]

    @property
    def threads(self) -> int:
        """Total number of threads of the suitable workers."""
        return sum(info["nthreads"] for address, info in self.infos().items() if address not in self.bad)

    @property
    def good(self) -> set[str]:
        """Addresses of the workers that can process takes."""
        return set(self.infos()) - set(self.bad)

    def note(self, text: str) -> None:
        """Store a note unless it is already known."""
        if text not in self._notes:
            self._notes.append(text)

    def infos(self) -> dict[str, Any]:
        """Return the scheduler's information about each worker, or {} if the scheduler does not answer."""
        try:
            return dict(self.client.scheduler_info(n_workers=-1)["workers"])
        except Exception:  # the connection is closing, which the next check reports
            return {}

    def allowed(self, ticket: Ticket) -> set[str] | None:
        """Return the workers that may process a take, or None for all."""
        good = self.good
        others = good - ticket.avoid
        if not self.bad and others == good:
            return None
        return others or good

    def state_memory(self, wanted_mb: float) -> bool:
        """Return whether every worker declares its memory in ``memory_mb``.

        Raises:
            WorkersUnsuitable: no worker has as much memory as a take is allowed to use.
        """
        stated = [info.get("resources", {}).get(MEMORY) for info in self.infos().values()]
        amounts = [amount for amount in stated if amount is not None]
        if amounts and max(amounts) < wanted_mb:
            message = f"No worker has the {wanted_mb:g} MB that a take may use. The largest has {max(amounts):g} MB."
            hint = "Lower --take-memory, or start workers with more memory."
            raise WorkersUnsuitable(message, where=self._address, hint=hint)
        return bool(amounts) and len(amounts) == len(stated)

    def wrote(self, worker: str, failure: str) -> None:
        """Count a worker's consecutive write failures. An empty ``failure`` resets the count."""
        if not failure:
            self._fails.pop(worker, None)
            return
        fails = self._fails[worker] = self._fails.get(worker, 0) + 1
        self.note(f"Worker {worker} could not write: {failure}")
        if fails >= _FAILS and len(self.good) > 1:
            self.bad[worker] = f"it could not write {fails} takes in a row"

    def forget_looks(self) -> None:
        """Check all workers again, because a new scheduler has other workers."""
        self._looked_at.clear()
        self._without = None

    def look_at_new(self) -> None:
        """Check the versions, folders and clocks of new workers."""
        new = sorted(set(self.infos()) - self._looked_at)
        if not new:
            return
        try:
            asked = time.time()
            found = self.client.run(describe, self._out, workers=new, on_error="return")
        except Exception:  # a worker that has just died is not checked again, all others are checked next time
            return
        self._looked_at.update(new)
        for worker, about in found.items():
            if isinstance(about, BaseException):
                if isinstance(about, ImportError):
                    self.bad[worker] = f"Manifold MoCap cannot be imported there ({about})"
                continue
            if wrong := what_is_wrong(about, self.versions, self._marker, self._out):
                self.bad[worker] = wrong
            ahead_s = about["time"] - asked
            if abs(ahead_s) > _CLOCK_S:
                clock = f"The clock of {about['host']} differs by {ahead_s:+.0f} s"
                self.note(f"{clock}, which affects only the times of files.")

    def require_some(self, patience_s: float | None = None) -> None:
        """Raise ``WorkersUnsuitable`` if there has been no suitable worker for ``patience_s`` seconds.

        The message contains the reasons for up to three workers. None means the engine's patience.
        """
        if self.good:
            self._without = None
            return
        now = time.monotonic()
        self._without = self._without or now
        if now - self._without < (self._patience_s if patience_s is None else patience_s):
            return
        reasons = "; ".join(f"{worker}: {why}" for worker, why in list(self.bad.items())[:3])
        message, hint = "The scheduler has no workers.", "Start workers with `dask worker ADDRESS --nthreads 1`."
        if reasons:
            message = f"No worker can solve the takes: {reasons}."
            hint = (
                "Workers need the same version, the same Python and the same folders as this program, under the same "
            )
            hint += "paths. Finished takes are kept."
        raise WorkersUnsuitable(message, where=self._address, hint=hint)
