"""Record of a batch's take: its inputs and the outcome of each step.

A step is done if its key is in the record and its files exist. Keys depend on the inputs, settings and version.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, NotRequired, TypedDict

from ..._exchange.errors import MocapError
from ..._exchange.events import Form, fits
from ..._exchange.json_file import read_json_file
from ..._exchange.outputs import write_text
from ..._exchange.verb_results import SolveResult
from ..._exchange.version import VERSION

NAME = "take.json"
UNFINISHED = "unfinished"
"""Status of a take that is in progress or was interrupted."""
FIGURES = ("frames", "reprojection_median_px", "marker_median_mm", "unsure_frames", "unseen_frames")
"""Results of a solve that are shown in the summary."""


class StepRecord(TypedDict):
    """Record of a finished step: its key, outputs, notes and duration."""

    key: str  # Hash of the step's inputs.
    outputs: list[str]  # File names in the take's folder.
    notes: list[str]
    seconds: float


class Attempt(TypedDict):
    """Record of one attempt at a step of a take."""

    step: str
    worker: str
    how: str  # "begun", "done", or the code of an error.
    message: NotRequired[str]


class Failure(TypedDict):
    """Error that made a take fail, as stored in its record."""

    event: NotRequired[str]
    code: str
    message: str
    where: NotRequired[str]
    hint: NotRequired[str]
    exit_code: int


class StepMade(TypedDict):
    """Result of a step, to add to the take's record."""

    outputs: list[str]  # File names in the take's folder.
    notes: list[str]
    figures: NotRequired[SolveResult]  # Results of the take's worst solve.
    people: NotRequired[list[str]]


class TakeRecord(TypedDict):
    """Record of a take. It is stored in the take's folder and in the summary."""

    take: str  # Name of the take's folder.
    capture: str
    status: str  # "unfinished", "done", "skipped", "failed" or "set aside".
    inputs: NotRequired[str]  # Key of the first step, made from the inputs.
    steps: NotRequired[dict[str, StepRecord]]  # Finished steps by name.
    attempts: NotRequired[list[Attempt]]
    solve: NotRequired[SolveResult]  # Results of the take's worst solve.
    people: NotRequired[list[str]]
    outputs: NotRequired[list[str]]  # Paths of the outputs of all steps.
    notes: NotRequired[list[str]]
    seconds: NotRequired[float]
    error: NotRequired[Failure]


def fingerprint(capture: Path, choices: dict[str, Any]) -> str:
    """Return a hash of a take's inputs: file names, sizes and times, the settings and the version."""
    files = sorted(capture.rglob("*")) if capture.is_dir() else [capture]
    status = {p.relative_to(capture.parent).as_posix(): p.stat() for p in files if p.is_file()}
    stated = [(name, one.st_size, one.st_mtime_ns) for name, one in status.items()]
    whole = json.dumps([stated, choices, VERSION], sort_keys=True)
    return hashlib.sha256(whole.encode()).hexdigest()


def step_key(before: str, step: str, choices: dict[str, Any]) -> str:
    """Return a step's key, computed from the previous step's key, the step's name and its settings."""
    return hashlib.sha256(json.dumps([before, step, choices], sort_keys=True).encode()).hexdigest()


def begun_record(take: str, capture: Path) -> TakeRecord:
    """Return the record of a take that has no finished steps."""
    return {"take": take, "capture": str(capture), "status": UNFINISHED}


def failure_of(error: MocapError) -> Failure:
    """Convert an error to the form that a take's record stores."""
    return {**error.as_event(), "exit_code": error.exit_code}


def is_step_done(record: TakeRecord, folder: Path, step: str, key: str) -> bool:
    """Return whether a step is recorded under this key and its outputs exist."""
    kept = (record.get("steps") or {}).get(step)
    return bool(kept) and kept.get("key") == key and all((folder / name).is_file() for name in kept.get("outputs", ()))


_TEXTS: Form = ["text"]
_RECORD: dict[str, Form] = dict.fromkeys(("take", "capture", "status"), "text") | {
    "steps?": {"*": {"key": "text", "outputs": _TEXTS, "notes": _TEXTS, "seconds": "number"}},
    "attempts?": ["object"],
    "solve?": {f"{name}?": "number" for name in FIGURES},
    "error?": {"code": "text", "message": "text", "exit_code": "whole"},
    "seconds?": "number",
    **dict.fromkeys(("outputs?", "notes?", "people?"), _TEXTS),
}
"""Form of the fields that every valid record has."""


def read_record(folder: Path) -> TakeRecord | None:
    """Return the record in a take's folder, or None if it is missing or damaged."""
    try:
        record: Any = read_json_file(folder / NAME)
    except MocapError:
        return None
    whole: Any = fits(_RECORD, record) and {key: value for key, value in record.items() if value is not None}
    return whole or None


def write_record(folder: Path, record: TakeRecord) -> None:
    """Write a take's record. The file is complete or is not written."""
    write_text(folder / NAME, json.dumps(record, indent=1, ensure_ascii=False), overwrite=True)
