"""Process a batch's captures: convert, solve and, if requested, bake, render and export them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from ..._exchange.diagnostics import read_diagnostics, sentence, warnings_in
from ..._exchange.outputs import write_text
from ..._exchange.reading_settings import options_of
from ..._exchange.verb_results import SolveResult
from ..children import run_solver, run_verb
from ..result import CommandResult
from ..verb_table import VERBS, run_here
from .record import StepMade, fingerprint, read_record, step_key
from .request import BatchRequest, TakeLimits, TakeWatch
from .work import Place, Plain, Step, from_plain, to_plain


@dataclass(frozen=True)
class Takes:
    """The takes of a batch, their steps, and the settings that all takes share."""

    request: BatchRequest
    choices: dict[str, Any]
    """Settings that affect the results (see ``BatchRequest.choices``), read once for all workers."""
    kind: ClassVar = "takes"

    @property
    def out(self) -> Path:
        """Folder for the results of the batch."""
        return self.request.out

    @property
    def limits(self) -> TakeLimits:
        """Limits of the solver for each take."""
        return self.request.limits

    def sees(self, item: Path) -> bool:
        """Return whether this machine can read a capture."""
        return item.exists()

    def steps(self, item: Path) -> tuple[Step, ...]:
        """Return the requested steps of a capture in order, with their keys."""
        request, choices = self.request, self.choices
        solve = fingerprint(item, {name: choices[name] for name in ("settings", "python")})
        wanted = {
            "bake": request.bake,
            "render": request.render,
            "export": bool(request.formats or request.marker_formats),
        }
        about = {name: choices[name] for name in ("formats", "markers", "body") if name in choices}
        chosen = {"bake": {"body": about["body"]}, "render": {"body": about["body"]}, "export": about}
        others = (Step(name, step_key(solve, name, chosen[name])) for name, asked in wanted.items() if asked)
        return Step("solve", solve), *others

    def do_step(self, item: Path, step: str, place: Place) -> StepMade:
        """Process a step of a take. Return output file names and notes, and for a solve the worst person's results."""
        if step == "solve":
            return _solve(self.request, self.choices["settings"], item, place)
        outputs, notes, shared = list[str](), list[str](), {"overwrite": True, "body": self.request.body}
        for motion in _motions(place.folder):
            if step != "export":
                values = {"motion": motion, "capture": place.folder / f"{place.folder.name}_capture.npz"}
                values |= {"out": place.folder, "footage_from": [item], **shared}
                made = _in_blender(step, values | ({"no_pictures": True} if step == "bake" else {}), place)
                outputs, notes = [*outputs, *made["outputs"]], [*notes, *made["notes"]]
                continue
            if self.request.formats:
                files = {"source": motion, "formats": self.request.formats, "out": place.folder / "export"}
                outputs += _in_blender(step, {**files, **shared}, place)["outputs"]
            outputs += _export_markers(self.request, motion, place)
        return {"outputs": [Path(path).relative_to(place.folder).as_posix() for path in outputs], "notes": notes}

    def plain(self) -> Plain:
        """Return the work as plain values for another process or machine, with absolute paths."""
        return {"kind": self.kind, "request": to_plain(self.request), "choices": self.choices}

    @classmethod
    def from_plain(cls, values: Plain) -> Takes:
        """Recreate the batch's settings from the JSON values of ``plain``."""
        request = values["request"]
        return cls(from_plain(BatchRequest, request, limits=TakeLimits(**request["limits"])), values["choices"])


def _solve(request: BatchRequest, shared: dict[str, Any], capture: Path, place: Place) -> StepMade:
    folder, name = place.folder, place.folder.name
    copy, motion, page = (folder / f"{name}{end}" for end in ("_capture.npz", ".npz", ".html"))
    sync = (shared.get("settings") or {}).get("sync")
    reading = options_of(shared) + [f"--sync={sync}"] * bool(sync)
    watch = TakeWatch(request.limits)
    about: dict[str, Any] = {"python": request.python, "stopped": lambda pid: place.stopped() or watch.over_limit(pid)}
    solver = partial(run_solver, progress=place.progress, **about)
    solver("convert", [str(capture), "--out", str(copy), "--overwrite", *reading])
    job_file = _write_job(folder, copy, motion, page, shared)
    spread = ["--scheduler", place.scheduler] if place.scheduler else []
    solved: Any = solver("solve", ["--job", str(job_file), *spread])
    solved.pop("event", None)
    takes: list[SolveResult] = solved.get("takes", [solved])
    files = [motion.name, page.name]
    if "takes" in solved:
        files = [Path(path).name for take in takes for path in (take["motion"], take["report"]) if path]
    worst = max(takes, key=lambda take: take.get("reprojection_median_px") or take.get("marker_median_mm") or 0.0)
    made: StepMade = {
        "outputs": [copy.name, job_file.name, *files],
        "notes": [sentence(item) for take in takes for item in warnings_in(read_diagnostics(take["diagnostics"]))],
        "figures": worst,
    }
    if "takes" in solved:
        made["people"] = [take.get("person", "") for take in takes]
    return made


def _in_blender(verb: str, values: dict[str, Any], place: Place) -> CommandResult:
    row = VERBS[verb]
    if place.in_child:
        return run_verb(verb, row.words(values), place.progress, place.stopped)
    return run_here(row.arguments(**values), place.progress)


def _export_markers(request: BatchRequest, motion: Path, place: Place) -> list[str]:
    record = read_record(place.folder)
    paths = [motion.parent / "export" / f"{motion.stem}.{name}" for name in request.marker_formats]
    if record is None or "solve" not in record or record["solve"].get("marker_median_mm") is None:
        return []
    for path in paths:
        options = [str(motion), "--out", str(path), "--overwrite"]
        run_solver("markers export", options, place.progress, python=request.python)
    return [str(path) for path in paths]


def _motions(folder: Path) -> list[Path]:
    record = read_record(folder)
    made = record["steps"]["solve"]["outputs"] if record is not None and "steps" in record else []
    return [folder / name for name in made if name.endswith(".npz") and name != f"{folder.name}_capture.npz"]


def _write_job(folder: Path, capture: Path, motion: Path, page: Path, shared: dict[str, Any]) -> Path:
    path = folder / f"{folder.name}.job.json"
    values = {"version": shared.get("version", 1), "capture": capture.name, "out": motion.name, "report": page.name}
    values |= {"overwrite": True, "settings": shared.get("settings") or {}}
    values |= {key: shared[key] for key in ("person", "strict") if shared.get(key)}
    return write_text(path, json.dumps(values, indent=1, ensure_ascii=False), overwrite=True)
