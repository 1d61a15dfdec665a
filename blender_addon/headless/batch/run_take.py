"""One take of a batch: converted, solved and, if wanted, baked, rendered and exported; or recalled."""

from __future__ import annotations

import json
import time
import traceback
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from ..._exchange.errors import Cancelled, MocapError, OutputExists, OutputNotWritable
from ..._exchange.outputs import atomic_outputs, is_free
from ..._exchange.progress import Progress
from ..bake import BakeRequest, run_bake
from ..exit_codes import BROKEN, exit_code
from ..export import ExportRequest, run_export
from ..solver import run_solver
from .limits import TakeWatch
from .record import fingerprint, read_record, write_record
from .request import READING, BatchRequest, take_name


def run_take(request: BatchRequest, choices: dict[str, Any], capture: Path, progress: Progress) -> dict[str, Any]:
    """Do one take, or recall it; errors become part of its record."""
    name = take_name(capture)
    folder = request.out / name
    record: dict[str, Any] = {"take": name, "capture": str(capture), "status": "failed"}
    start = time.monotonic()

    def of_take(stage: str, done: int, total: int) -> None:
        progress(f"{name}: {stage}", done, total)

    try:
        record["inputs"] = fingerprint(capture, choices)
        known = _known(folder)
        if _is_done(known, record["inputs"]):
            return {**known, "status": "skipped"}
        write_record(folder, record)
        record |= _made(request, choices, capture, folder, of_take)
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
    if known is None and not is_free(folder):
        raise OutputExists(
            "The take's folder holds files that no batch has written.", where=str(folder), hint="Choose another --out."
        )
    return known or {}


def _is_done(known: dict[str, Any], inputs: str) -> bool:
    same = known.get("status") == "done" and known.get("inputs") == inputs
    return same and all(Path(path).is_file() for path in known["outputs"])


def _made(
    request: BatchRequest, choices: dict[str, Any], capture: Path, folder: Path, progress: Progress
) -> dict[str, Any]:
    """Convert, solve, bake, render and export one capture, and return what goes into its record."""
    name, shared = folder.name, choices["settings"]
    copy, motion, page = (folder / f"{name}{end}" for end in ("_capture.npz", ".npz", ".html"))
    said = {flag: str(shared[key]) for key, flag in READING.items() if shared.get(key) is not None}
    reading = [text for option in said.items() for text in option]
    reading += ["--trim"] if shared.get("trim") else []
    solver = partial(
        run_solver, progress=progress, python=request.python, over_limit=TakeWatch(request.limits).over_limit
    )
    solver("convert", [str(capture), "--out", str(copy), "--overwrite", *reading])
    job_file = _write_job(folder, copy, motion, page, shared)
    solved = solver("solve", ["--job", str(job_file)])
    outputs, notes = [str(copy), str(job_file)], list(solved.get("problems", []))
    takes = solved.get("takes", [solved])
    for take in takes:
        own = (Path(take["motion"]), Path(take["report"])) if "takes" in solved else (motion, page)
        made, said = _made_of(request, copy, own[0], take, progress)
        outputs, notes = [*outputs, *map(str, own), *made], notes + said
    worst = max(takes, key=lambda take: take.get("reprojection_median_px") or take.get("marker_median_mm") or 0.0)
    figures = {key: value for key, value in worst.items() if key != "event"}
    whole = {"people": [take.get("person", "") for take in takes]} if "takes" in solved else {}
    return {"solve": figures, **whole, "outputs": outputs, "notes": notes}


def _made_of(
    request: BatchRequest, copy: Path, motion: Path, solved: dict[str, Any], progress: Progress
) -> tuple[list[str], list[str]]:
    """Bake, render and export one motion, and return the files and what was noted."""
    folder, outputs, notes = motion.parent, list[str](), list[str]()
    if request.bake or request.render:
        wanted = BakeRequest(
            motion,
            folder,
            copy,
            request.body,
            blend=request.bake,
            video=request.render,
            pictures=request.render,
            overwrite=True,
        )
        baked = run_bake(wanted, progress)
        outputs, notes = outputs + baked["outputs"], baked["notes"]
    if request.formats:
        exports = folder / "export"
        exported = run_export(ExportRequest(motion, exports, request.formats, request.body, overwrite=True), progress)
        outputs += exported["outputs"]
    return outputs + _exported_markers(request, motion, solved, progress), notes


def _exported_markers(request: BatchRequest, motion: Path, solved: dict[str, Any], progress: Progress) -> list[str]:
    """Write the cleaned markers of a take that was solved from markers, and return the files."""
    paths = [motion.parent / "export" / f"{motion.stem}.{name}" for name in request.marker_formats]
    if solved.get("marker_median_mm") is None:
        return []
    for path in paths:
        options = [str(motion), "--out", str(path), "--overwrite"]
        run_solver("export-markers", options, progress, python=request.python)
    return [str(path) for path in paths]


def _write_job(folder: Path, capture: Path, motion: Path, page: Path, shared: dict[str, Any]) -> Path:
    path = folder / f"{folder.name}.job.json"
    values = {
        "version": shared.get("version", 1), "capture": capture.name, "out": motion.name, "report": page.name,
        "overwrite": True, "settings": shared.get("settings") or {},
    }  # fmt: skip
    values |= {"person": shared["person"]} if shared.get("person") else {}
    with atomic_outputs(folder, (path.name,), overwrite=True) as temporary:
        temporary[path.name].write_text(json.dumps(values, indent=1, ensure_ascii=False), encoding="utf-8")
    return path
