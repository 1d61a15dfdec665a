"""The record of a take: the inputs of each step, and how it went. It is the only state of a batch.

A step is done if the record holds its key and its files are there. Keys follow from inputs, settings and version.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, NotRequired, TypedDict, TypeGuard

from ..._exchange.errors import MocapError
from ..._exchange.json_file import read_json_file
from ..._exchange.outputs import atomic_outputs
from ..._exchange.verb_results import SolveResult
from ..._exchange.version import VERSION

NAME = "take.json"
UNFINISHED = "unfinished"
"""Status of a take that somebody works on, or was working on when it was interrupted."""
FIGURES = ("frames", "reprojection_median_px", "marker_median_mm", "unsure_frames", "unseen_frames")
"""Numbers of a solve that the summary shows."""
_MOST = 1e12  # Above every count, residual and time; chosen by hand.


class StepRecord(TypedDict):
    """A step that was done."""

    key: str  # Hash of its inputs.
    outputs: list[str]  # Names in the take's folder.
    notes: list[str]
    seconds: float


class Attempt(TypedDict):
    """An attempt at a step."""

    step: str
    worker: str
    how: str  # begun, done or the code of an error.
    message: NotRequired[str]


class Failure(TypedDict):
    """Why a take failed."""

    event: NotRequired[str]
    code: str
    message: str
    where: NotRequired[str]
    hint: NotRequired[str]
    exit_code: int


class StepMade(TypedDict):
    """The result of a step, for the record."""

    outputs: list[str]  # Names in the take's folder.
    notes: list[str]
    figures: NotRequired[SolveResult]  # Of the worst of the take's solves.
    people: NotRequired[list[str]]


class TakeRecord(TypedDict):
    """A take's record, in its folder and in the summary."""

    take: str  # Name of its folder.
    capture: str
    status: str  # unfinished, done, skipped, failed or set aside.
    inputs: NotRequired[str]  # Key of the first step.
    steps: NotRequired[dict[str, StepRecord]]  # By name.
    attempts: NotRequired[list[Attempt]]
    solve: NotRequired[SolveResult]  # Of the worst of the take's solves.
    people: NotRequired[list[str]]
    outputs: NotRequired[list[str]]  # Of all steps, as paths.
    notes: NotRequired[list[str]]
    seconds: NotRequired[float]
    error: NotRequired[Failure]


def fingerprint(capture: Path, choices: dict[str, Any]) -> str:
    """Return a hash of a take's inputs: names, sizes and times of files, settings, version.

    Args:
        capture: file, or folder with all it holds.
        choices: settings and outputs, as plain values.
    """
    files = sorted(capture.rglob("*")) if capture.is_dir() else [capture]
    status = {p.relative_to(capture.parent).as_posix(): p.stat() for p in files if p.is_file()}
    stated = [(name, one.st_size, one.st_mtime_ns) for name, one in status.items()]
    whole = json.dumps([stated, choices, VERSION], sort_keys=True)
    return hashlib.sha256(whole.encode()).hexdigest()


def step_key(before: str, step: str, choices: dict[str, Any]) -> str:
    """Return the key of a step that works on the results of another step.

    Args:
        before: key of that other step.
        choices: settings of its outputs, as plain values.
    """
    return hashlib.sha256(json.dumps([before, step, choices], sort_keys=True).encode()).hexdigest()


def begun_record(take: str, capture: Path) -> TakeRecord:
    """Return the record of a take without any finished step."""
    return {"take": take, "capture": str(capture), "status": UNFINISHED}


def failure_of(error: MocapError) -> Failure:
    """Return an error as a record has it."""
    return {**error.as_event(), "exit_code": error.exit_code}


def is_step_done(record: TakeRecord, folder: Path, step: str, key: str) -> bool:
    """Return whether a step's outputs are there, made with this key."""
    kept = (record.get("steps") or {}).get(step)
    return bool(kept) and kept.get("key") == key and all((folder / name).is_file() for name in kept.get("outputs", ()))


def read_record(folder: Path) -> TakeRecord | None:
    """Return the record of a take's folder, None where there is none, or it cannot be read."""
    try:
        record = read_json_file(folder / NAME)
    except MocapError:
        return None
    return record if _is_record(record) else None


def _is_record(value: Any) -> TypeGuard[TakeRecord]:
    """Return whether a value has the parts of a record, with the right types and numbers that can be shown."""
    if not isinstance(value, dict):
        return False
    steps, attempts = value.get("steps") or {}, value.get("attempts") or []
    solved, error = value.get("solve") or {}, value.get("error")
    return (
        all(isinstance(value.get(key), str) for key in ("take", "capture", "status"))
        and isinstance(steps, dict)
        and all(_is_step(step) for step in steps.values())
        and isinstance(attempts, list)
        and all(isinstance(attempt, dict) for attempt in attempts)
        and isinstance(solved, dict)
        and all(solved.get(key) is None or _is_number(solved[key]) for key in FIGURES)
        and (error is None or _is_failure(error))
        and all(_texts(value.get(key, [])) for key in ("outputs", "notes", "people"))
        and (value.get("seconds") is None or _is_number(value["seconds"]))
    )


def _is_step(step: Any) -> bool:
    return (
        isinstance(step, dict)
        and isinstance(step.get("key"), str)
        and all(_texts(step.get(key)) for key in ("outputs", "notes"))
        and _is_number(step.get("seconds"))
    )


def _is_failure(error: Any) -> bool:
    texts = isinstance(error, dict) and all(isinstance(error.get(key), str) for key in ("code", "message"))
    return texts and isinstance(error.get("exit_code"), int)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and -_MOST < value < _MOST


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def write_record(folder: Path, record: TakeRecord) -> None:
    """Write a take's record, whole or not at all."""
    with atomic_outputs(folder, (NAME,), overwrite=True) as temporary:
        temporary[NAME].write_text(json.dumps(record, indent=1, ensure_ascii=False), encoding="utf-8")
