"""Process one take of a batch: convert, solve, bake, render and export it."""

from __future__ import annotations

import time
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..._exchange.errors import Cancelled, ExitCode, MocapError, OutputExists, OutputNotWritable
from ..._exchange.outputs import full_disk, is_free
from ..._exchange.progress import Progress, prefixed
from .record import (
    UNFINISHED,
    Failure,
    StepMade,
    StepRecord,
    TakeRecord,
    begun_record,
    failure_of,
    is_step_done,
    read_record,
    write_record,
)
from .work import Place, Step, Work, take_name

_KEPT_ATTEMPTS = 20  # Number of recent attempts stored in a take's record. Chosen by hand.


def run_take(work: Work, capture: Path, progress: Progress, **place: Any) -> TakeRecord:
    """Process all steps of one take, or reuse earlier results, and return its record."""
    record = recalled(work, capture)
    if record is not None:
        return record
    try:
        names = [step.name for step in work.steps(capture)]
    except OSError:  # the first step reports the cause
        names = ["solve"]
    for step in names:
        record = run_step(work, capture, step, progress, **place)
        if record["status"] != UNFINISHED:
            break
    assert record is not None
    return record


def recalled(work: Work, capture: Path) -> TakeRecord | None:
    """Return the record of a take that is finished, or set aside after failed attempts, or None if steps remain."""
    folder = work.out / take_name(capture)
    known = read_record(folder)
    try:
        steps = work.steps(capture)
    except OSError:
        return None
    if known is None:
        return None
    if known.get("status") == "set aside" and known.get("inputs") == steps[0].key:
        return known
    done = known.get("status") == "done" and all(is_step_done(known, folder, s.name, s.key) for s in steps)
    return _whole(known, folder, steps, "skipped") if done else None


def run_step(work: Work, capture: Path, step: str, progress: Progress, *, worker: str = "", **place: Any) -> TakeRecord:
    """Process one step of a take, unless it is finished or not requested. Return the take's record.

    Several workers may run the same step at once. Outputs get their final names when they are complete, and the record
    is written last.

    Args:
        worker: name of the worker, for the record.
        place: the fields ``stopped``, ``in_child`` and ``scheduler`` of a ``Place``.
    """
    name = take_name(capture)
    folder = work.out / name
    record = begun_record(name, capture)
    start = time.monotonic()
    try:
        wanted = work.steps(capture)
        record = _known(record, folder, wanted)
        mine = next((one for one in wanted if one.name == step), None)
        if mine is not None and not is_step_done(record, folder, mine.name, mine.key):
            record = _begun(record, folder, step, worker)
            made = work.do_step(capture, step, Place(folder, prefixed(progress, f"{name}: "), **place))
            record = _ended(record, mine, made, time.monotonic() - start)
        if all(is_step_done(record, folder, s.name, s.key) for s in wanted):
            record = _whole(record, folder, wanted, "done")
        if mine is not None:
            write_record(folder, record)
        return record
    except Cancelled:
        raise
    except MocapError as error:
        return failed(record, folder, failure_of(error))
    except Exception as error:  # an error in one take must not stop the others
        if (named := full_disk(error)) is not None:
            return failed(record, folder, failure_of(named))
        traceback.print_exc()
        message = f"{type(error).__name__}: {error}"
        failure: Failure = {"code": "take_failed", "message": message, "exit_code": ExitCode.FAILED}
    return failed(record, folder, failure)


def failed(record: TakeRecord, folder: Path, failure: Failure, status: str = "failed") -> TakeRecord:
    """Add a failure to a take's record, write the record to the take's folder if possible, and return it."""
    record = {**record, "status": status, "error": failure}
    if attempts := record.get("attempts"):
        attempts[-1]["how"], attempts[-1]["message"] = failure["code"], failure["message"]
    with suppress(OutputNotWritable):
        if read_record(folder) is not None:
            write_record(folder, record)
    return record


def _known(record: TakeRecord, folder: Path, wanted: tuple[Step, ...]) -> TakeRecord:
    """Add the record in a take's folder to a new record, if both were made from the same inputs."""
    known = read_record(folder)
    if known is None and not is_free(folder):
        message = "The take's folder contains files that no batch wrote."
        raise OutputExists(message, where=str(folder), hint="Choose another --out.")
    record = {**record, "inputs": wanted[0].key}
    if known is None or known.get("inputs") != record["inputs"]:
        return record
    earlier: Any = known
    kept: Any = {key: earlier[key] for key in ("steps", "attempts", "solve", "people") if key in earlier}
    record.update(kept)
    return record


def _begun(record: TakeRecord, folder: Path, step: str, worker: str) -> TakeRecord:
    """Note in a take's record that a step has begun, then write and return the record."""
    attempts = [*record.get("attempts", ())][-_KEPT_ATTEMPTS:]
    record = {**record, "attempts": [*attempts, {"step": step, "worker": worker, "how": "begun"}]}
    write_record(folder, record)
    return record


def _ended(record: TakeRecord, step: Step, made: StepMade, seconds: float) -> TakeRecord:
    record = {**record, "attempts": [*record.get("attempts", ())]}
    record["attempts"][-1]["how"] = "done"
    if "figures" in made:
        record["solve"] = made["figures"]
    if "people" in made:
        record["people"] = made["people"]
    kept = StepRecord(key=step.key, outputs=made["outputs"], notes=made["notes"], seconds=round(seconds, 2))
    return {**record, "steps": {**record.get("steps", {}), step.name: kept}}


def _whole(record: TakeRecord, folder: Path, wanted: tuple[Step, ...], status: str) -> TakeRecord:
    kept = record.get("steps", {})
    steps = [kept[step.name] for step in wanted]
    return {
        **record,
        "status": status,
        "outputs": [str(folder / name) for step in steps for name in step["outputs"]],
        "notes": [note for step in steps for note in step["notes"]],
        "seconds": round(sum(step["seconds"] for step in steps), 2),
    }
