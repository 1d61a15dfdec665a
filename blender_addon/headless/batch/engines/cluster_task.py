"""Run a task on a worker of a cluster. Arguments and results are plain values."""

from __future__ import annotations

import platform
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NotRequired, TypedDict

from ...._exchange.errors import Cancelled, MocapError
from ...._exchange.outputs import write_text
from ...._exchange.progress import silent
from ...._exchange.version import VERSION
from ..record import UNFINISHED, TakeRecord
from ..run_take import recalled, run_step
from ..shots import Shots
from ..takes import Takes
from ..work import Plain, Work

MARKER = ".batch"


def put_marker(out: Path) -> str:
    """Write a new marker file, which shows that a batch uses the results folder. Return its random text."""
    text = secrets.token_hex(16)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / MARKER, text, overwrite=True)
    return text


def marker_in(out: Path) -> str:
    """Return the text of a results folder's marker file, or "" if this machine does not see one."""
    try:
        return (out / MARKER).read_text(encoding="utf-8")[:64]
    except (OSError, UnicodeDecodeError):
        return ""


def remove_marker(out: Path, text: str) -> None:
    """Remove this batch's marker file, so that workers stop its takes."""
    with suppress(OSError):
        if marker_in(out) == text:
            (out / MARKER).unlink()


_KINDS: dict[str, type[Takes] | type[Shots]] = {kind.kind: kind for kind in (Takes, Shots)}


def work_of(values: Plain) -> Work:
    """Recreate a batch's work from the values of ``Work.plain``."""
    return _KINDS[values["kind"]].from_plain(values)


_LOOK_S, _LOOKS = 2.0, 3  # Consecutive checks that must find no marker, because a network folder may briefly vanish.


class Batch(TypedDict):
    """Data that every task of a batch receives."""

    work: Plain  # See ``Work.plain``.
    out: str
    capture: str
    marker: str
    versions: dict[str, str]
    stretches: bool


class WorkerFacts(TypedDict):
    """A worker's description of itself, to find out whether it can process a batch."""

    versions: dict[str, str]
    marker: str  # Text of the marker that the worker sees in the results folder.
    time: float  # Time on the worker's clock in seconds.
    host: str


class TaskResult(TypedDict):
    """Result of a step: its record, or the reason why the worker is unsuitable."""

    worker: str
    record: NotRequired[TakeRecord]
    unsuitable: NotRequired[str]


def versions() -> dict[str, str]:
    """Return the versions that every worker of a batch must have."""
    from importlib.metadata import version as version_of

    python = ".".join(platform.python_version_tuple()[:2])
    return {"Manifold MoCap": VERSION, "Dask distributed": version_of("distributed"), "Python": python}


def describe(out: str) -> WorkerFacts:
    """Return the versions, marker, clock and host name of the worker that runs this function."""
    return {"versions": versions(), "marker": marker_in(Path(out)), "time": time.time(), "host": platform.node()}


def what_is_wrong(about: WorkerFacts, wanted: dict[str, str], marker: str, out: str) -> str:
    """Return the reason why a worker cannot process a batch's takes, or "" if it can."""
    for name, mine in wanted.items():
        theirs = about["versions"].get(name, "none")
        if theirs != mine:
            return f"it has {name} {theirs}, but this program has {mine}"
    return "" if about["marker"] == marker else f"it does not see the folder {out}"


def step_of_take(given: Batch, step: str, before: TaskResult | None) -> TaskResult:
    """Process one step of a take on a worker, given the result of the previous step."""
    from distributed import get_worker, secede

    if before is not None and ("record" not in before or before["record"]["status"] != UNFINISHED):
        return before
    worker = get_worker().address
    wrong = what_is_wrong(describe(given["out"]), given["versions"], given["marker"], given["out"])
    if wrong:
        return {"worker": worker, "unsuitable": wrong}
    work, capture = work_of(given["work"]), Path(given["capture"])
    if not work.sees(capture):
        return {"worker": worker, "unsuitable": f"it does not see the capture {capture}"}
    known = recalled(work, capture)
    if known is None:
        if given["stretches"]:
            secede()  # frees the thread for segments of this same take
        scheduler = get_worker().scheduler.address if given["stretches"] else ""
        place = {"stopped": _withdrawn(work.out, given["marker"]), "in_child": True, "scheduler": scheduler}
        known = run_step(work, capture, step, silent, worker=worker, **place)
    return {"worker": worker, "record": known}


def _withdrawn(out: Path, marker: str) -> Callable[[], MocapError | None]:
    """Return a function that checks whether the batch was withdrawn."""
    looked, missed = time.monotonic(), 0

    def stopped() -> MocapError | None:
        nonlocal looked, missed
        if time.monotonic() - looked < _LOOK_S:
            return None
        looked, missed = time.monotonic(), 0 if marker_in(out) == marker else missed + 1
        return Cancelled("The batch was withdrawn.") if missed >= _LOOKS else None

    return stopped
