"""``batch``: every capture of a folder solved and, if wanted, baked, rendered and exported.

A take that fails does not stop the others. What was done is recorded beside each take, so that a batch that is started
again does only what is missing or whose inputs, settings or version have changed.
"""

from __future__ import annotations

import json
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._exchange.errors import Cancelled, MocapError, OutputExists, OutputNotWritable
from .._exchange.outputs import atomic_outputs
from .._exchange.progress import Progress
from ..errors import BatchInvalid
from .bake import BakeJob, run_bake
from .exit_codes import BROKEN, exit_code
from .export import ExportJob, run_export
from .record import fingerprint, read_record, write_record
from .solver import run_solver
from .summary import table, worst_first

SUMMARY = "summary"
_READING = {"fps": "--fps", "joint_set": "--joint-set", "unit": "--unit", "up_axis": "--up-axis"}
_SHARED_KEYS = frozenset({"version", "trim", "settings", *_READING})


@dataclass(frozen=True)
class BatchJob:
    """What to do with every capture of a folder."""

    captures: Path
    """Folder; each file ``.npz`` and each folder in it is a capture."""
    out: Path
    """Folder of the results: one folder a take, and the summary."""
    job: Path | None = None
    """Job file without capture and out: how to read and to solve."""
    bake: bool = False
    """Write a Blender file of each take."""
    render: bool = False
    """Write a video and a contact sheet of each take."""
    formats: tuple[str, ...] = ()
    """Formats to export each take to."""
    body: Path | None = None
    """Body file; None for the one each motion is solved for."""
    python: Path | None = None
    """Python to solve with; None for this one."""

    def choices(self) -> dict[str, Any]:
        """Return what decides what is made of a capture, as plain values."""
        plain = {"bake": self.bake, "render": self.render, "formats": self.formats, "settings": _shared(self.job)}
        return {**plain, "body": str(self.body), "python": str(self.python)}


def run_batch(job: BatchJob, progress: Progress) -> dict[str, Any]:
    """Do all takes and write ``summary.json`` and ``summary.txt``.

    Returns:
        The ``result`` event: the takes, worst first, the table, the outputs and the exit code.

    Raises:
        BatchInvalid: there are no captures, or the job file is not one for batches.
        OutputNotWritable: the folder of the results cannot be written to.
        Cancelled: the work was interrupted; finished takes are kept.
    """
    choices = job.choices()
    captures = find_captures(job)
    takes = []
    for number, capture in enumerate(captures):
        progress("takes", number, len(captures))
        takes.append(_take(job, choices, capture, progress))
        _write_summary(job.out, takes)
    progress("takes", len(captures), len(captures))
    ordered = worst_first(takes)
    outputs = [str(job.out / f"{SUMMARY}{suffix}") for suffix in (".json", ".txt")]
    codes = [take["error"]["exit_code"] for take in takes if take.get("error")]
    return {
        "event": "result", "takes": ordered, "table": table(ordered), "outputs": outputs, "notes": [],
        "exit_code": max(codes, default=0),
    }  # fmt: skip


def find_captures(job: BatchJob) -> list[Path]:
    """Return the captures of the folder by name, hidden files and the results left out.

    Raises:
        BatchInvalid: there are none, or two would share a name.
    """
    if not job.captures.is_dir():
        raise BatchInvalid("There is no such folder.", where=str(job.captures), hint="Name the folder of the captures.")
    found = [
        path
        for path in sorted(job.captures.iterdir())
        if (path.is_dir() or path.suffix.lower() == ".npz")
        and not path.name.startswith(".")
        and path.resolve() != job.out.resolve()
    ]
    names = [_name(path) for path in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice or not found:
        raise BatchInvalid(
            f"Two captures are called {', '.join(twice)}." if twice else "The folder holds no captures.",
            where=str(job.captures),
            hint="Each file .npz and each folder in it is a capture with a name of its own.",
        )
    return found


def _take(job: BatchJob, choices: dict[str, Any], capture: Path, progress: Progress) -> dict[str, Any]:
    """Do one take, or recall it; errors become part of its record."""
    name = _name(capture)
    folder = job.out / name
    record: dict[str, Any] = {"take": name, "capture": str(capture), "status": "failed"}
    start = time.monotonic()
    try:
        record["inputs"] = fingerprint(capture, choices)
        known = _known(folder)
        if _is_done(known, record["inputs"]):
            return {**known, "status": "skipped"}
        write_record(folder, record)
        record |= _made(job, choices, capture, folder, lambda stage, *count: progress(f"{name}: {stage}", *count))
        record |= {"status": "done", "seconds": round(time.monotonic() - start, 2)}
        write_record(folder, record)
        return record
    except Cancelled:
        raise
    except MocapError as error:
        failure = error.as_event() | {"exit_code": exit_code(error)}
    except Exception as error:  # what breaks one take must not stop the others
        traceback.print_exc()
        failure = {"code": "take_failed", "message": f"{type(error).__name__}: {error}", "exit_code": BROKEN}
    record |= {"status": "failed", "error": failure}
    with suppress(OutputNotWritable):
        if read_record(folder) is not None:
            write_record(folder, record)
    return record


def _known(folder: Path) -> dict[str, Any]:
    """Return the record of a take's folder, an empty one for a folder that is new.

    Raises:
        OutputExists: the folder holds files that are not ours.
    """
    known = read_record(folder)
    if known is None and folder.is_dir() and any(folder.iterdir()):
        raise OutputExists(
            "The take's folder holds files that no batch has written.", where=str(folder), hint="Choose another --out."
        )
    return known or {}


def _is_done(known: dict[str, Any], inputs: str) -> bool:
    same = known.get("status") == "done" and known.get("inputs") == inputs
    return same and all(Path(path).is_file() for path in known["outputs"])


def _made(job: BatchJob, choices: dict[str, Any], capture: Path, folder: Path, progress: Progress) -> dict[str, Any]:
    """Convert, solve, bake, render and export one capture, and return what goes into its record."""
    name, shared = folder.name, choices["settings"]
    copy, motion, page = (folder / f"{name}{end}" for end in ("_capture.npz", ".npz", ".html"))
    said = {flag: str(shared[key]) for key, flag in _READING.items() if shared.get(key) is not None}
    reading = [text for option in said.items() for text in option]
    reading += ["--trim"] if shared.get("trim") else []
    run_solver("convert", [str(capture), "--out", str(copy), "--overwrite", *reading], progress, python=job.python)
    job_file = _write_job(folder, copy, motion, page, shared)
    solved = run_solver("solve", ["--job", str(job_file)], progress, python=job.python)
    outputs, notes = [str(copy), str(job_file), str(motion), str(page)], list(solved.get("problems", []))
    if job.bake or job.render:
        wanted = BakeJob(
            motion, folder, copy, job.body, blend=job.bake, video=job.render, pictures=job.render, overwrite=True
        )
        baked = run_bake(wanted, progress)
        outputs, notes = outputs + baked["outputs"], notes + baked["notes"]
    if job.formats:
        exports = folder / "export"
        exported = run_export(ExportJob(motion, exports, job.formats, job.body, overwrite=True), progress)
        outputs += exported["outputs"]
    figures = {key: value for key, value in solved.items() if key != "event"}
    return {"solve": figures, "outputs": outputs, "notes": notes}


def _write_job(folder: Path, capture: Path, motion: Path, page: Path, shared: dict[str, Any]) -> Path:
    path = folder / f"{folder.name}.job.json"
    values = {
        "version": shared.get("version", 1), "capture": capture.name, "out": motion.name, "report": page.name,
        "overwrite": True, "settings": shared.get("settings") or {},
    }  # fmt: skip
    with atomic_outputs(folder, (path.name,), overwrite=True) as temporary:
        temporary[path.name].write_text(json.dumps(values, indent=1, ensure_ascii=False), encoding="utf-8")
    return path


def _write_summary(out: Path, takes: list[dict[str, Any]]) -> None:
    ordered = worst_first(takes)
    texts = {
        f"{SUMMARY}.json": json.dumps(ordered, indent=1, ensure_ascii=False),
        f"{SUMMARY}.txt": table(ordered) + "\n",
    }
    with atomic_outputs(out, tuple(texts), overwrite=True) as temporary:
        for name, text in texts.items():
            temporary[name].write_text(text, encoding="utf-8")


def _shared(path: Path | None) -> dict[str, Any]:
    """Return what a batch's job file says.

    Raises:
        BatchInvalid: it cannot be read, or names a capture of its own.
    """
    if path is None:
        return {}
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BatchInvalid(f"The job file cannot be read: {error}.", where=str(path)) from error
    unknown = sorted(set(values) - _SHARED_KEYS) if isinstance(values, dict) else ["anything but an object"]
    if unknown:
        raise BatchInvalid(
            f"A batch's job file cannot hold {', '.join(unknown)}.",
            where=str(path),
            hint=f"It may hold {', '.join(sorted(_SHARED_KEYS))}.",
        )
    return values


def _name(capture: Path) -> str:
    return capture.stem if capture.is_file() else capture.name
