"""Send the captures of a batch to an engine, and retry takes that failed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path

from ..._exchange.outputs import write_text
from ..._exchange.plain_text import plain
from ..._exchange.progress import Progress
from ...errors import TakeUndoable
from .engines.base import DIED, LOST, Ended, Engine, Ticket
from .record import Failure, TakeRecord, begun_record, failure_of, read_record
from .request import Listed, Watched
from .run_take import failed, recalled
from .work import Work, take_name

SET_ASIDE = "set aside"
"""Status of a take that is not retried until its inputs, its settings or the version change."""
_CRASHES = frozenset({"solver_died", "take_failed", "take_too_large", "solver_failed", "bake_failed"})
"""Failures that a worker or a take can cause. The take is retried a few times and then set aside."""
_OF_THE_WORKER = frozenset({"output_not_writable", "backend_missing", "python_unsuitable", "render_failed"})
"""Failures that a worker causes. The take is retried on other workers, and finally recorded as an ordinary failure."""
_WAIT_S = 0.5  # Seconds to wait for finished takes in each loop. Chosen by hand.


def dispatch(
    work: Work, source: Listed | Watched, engine: Engine, progress: Progress, ended: Callable[[TakeRecord, bool], None]
) -> None:
    """Process all takes from a source. Pass each record to ``ended``, with True if it comes from an earlier run."""
    waiting: deque[Ticket] = deque()
    running, total, done = 0, 0, 0
    while True:
        for capture in source.arrived():
            known = recalled(work, capture)
            if known is not None:
                ended(known, True)
            else:
                total += 1
                waiting.append(Ticket(capture, take_name(capture)))
        progress(work.kind, done, total)
        while waiting and engine.free() > 0:
            engine.begin(waiting.popleft())
            running += 1
        if not waiting and not running and source.closed:
            return
        for one in engine.ended(_WAIT_S):
            running -= 1
            again = _again(engine, one)
            if again is None:
                done += 1
                ended(_record_of(work, one, engine), False)
            else:
                waiting.append(again)


def _again(engine: Engine, one: Ended) -> Ticket | None:
    if one.how == LOST:
        return one.ticket
    code = _code_of(one)
    if one.how == DIED or code not in _CRASHES | _OF_THE_WORKER:
        return None
    one.ticket.tries += 1
    one.ticket.avoid.add(one.worker)
    return one.ticket if one.ticket.tries < engine.tries else None


def _code_of(one: Ended) -> str:
    error = None if one.record is None else one.record.get("error")
    return error["code"] if error else ""


def _record_of(work: Work, one: Ended, engine: Engine) -> TakeRecord:
    """Return the take's last record. If the take crashed its workers, the record includes a log."""
    folder = work.out / one.ticket.name
    code, record = _code_of(one), one.record
    if record is not None and record["status"] == "skipped":  # done by a worker that died before it could report it
        return {**record, "status": "done"}
    if record is not None and one.how != DIED and (engine.tries == 1 or code not in _CRASHES):
        return record
    if record is None or "error" not in record:
        known = read_record(folder) or begun_record(one.ticket.name, one.ticket.capture)
        hint = "Solve it alone, with --take-memory. It is not retried until its files or settings change."
        what = "Every worker that tried this take stopped."
        record, why = known, failure_of(TakeUndoable(what, where=str(one.ticket.capture), hint=hint))
    else:
        why = record["error"]
    record = failed(record, folder, why, SET_ASIDE)
    _write_log(folder, record, why)
    return record


def _write_log(folder: Path, record: TakeRecord, why: Failure) -> None:
    lines = [f"{record['take']} was set aside: {why['message']}", f"capture: {record['capture']}", ""]
    for number, attempt in enumerate(record.get("attempts", ()), 1):
        message = attempt.get("message", "")
        where = attempt["worker"] or "this machine"
        lines.append(f"{number}. {attempt['step']} on {where}: {attempt['how']} {message}")
    if folder.is_dir():
        write_text(folder / "take.log", "".join(f"{plain(line)}\n" for line in lines), overwrite=True)
