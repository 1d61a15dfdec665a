"""``studio``: a description in; captures with truth, pictures and, if asked, an evaluated solve out."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import NotRequired

from .._exchange.json_file import read_json_file
from .._exchange.progress import Progress
from .._exchange.verb_results import BenchmarkResult, BenchmarkRow, DataSetPlan
from .batch.dispatch import dispatch
from .batch.record import TakeRecord
from .batch.request import Spread
from .batch.run_batch import engine_for
from .batch.shots import Shots, digest_of, require_all
from .batch.source import Listed
from .blender_module import require_blender
from .result import CommandResult
from .solver import run_solver


@dataclass(frozen=True)
class StudioRequest:
    """What to make."""

    description: Path
    """JSON file."""
    out: Path
    """Folder of the data set."""
    plan: bool = False
    """Only check, and report what would be made."""
    benchmark: tuple[str, ...] = ()
    """Methods to evaluate on it, none for no evaluation."""
    places: bool = False
    """Also map the arrays' errors over the floor."""
    python: Path | None = None
    """Python to solve with."""
    spread: Spread = field(default_factory=Spread)
    """Who makes the shots; by default this process, one after the other."""
    colour_of: str = ""
    """Only the colour pictures of this shot, which is there already."""
    settings: Path | None = None
    """JSON file of what ``studio-benchmark`` solves with."""


class StudioResult(DataSetPlan, CommandResult):
    """Of ``studio``."""

    seconds: NotRequired[float]
    page: NotRequired[str]
    rows: NotRequired[list[BenchmarkRow]]
    places: NotRequired[str]


def run_studio(request: StudioRequest, progress: Progress) -> CommandResult:
    """Make a data set: the backend films truth, infrared, depth and masks, Blender colour; a killed run resumes.

    Returns:
        The ``result`` event: the folder, shots, frames, pictures, seconds, and the table of ``studio-benchmark``.

    Raises:
        SolverStopped: the backend ended with an error: a description, motion, array or disk that will not do.
        RenderFailed: this Blender lacks the engine, or cannot render.
    """
    start = time.monotonic()
    if request.colour_of:
        return _colour_of(request, progress)
    given = [str(request.description), "--out", str(request.out)]
    spread = bool(request.spread.scheduler or request.spread.workers)
    begin = "--claim" if spread and not request.plan else "--plan"
    planned: DataSetPlan = run_solver("studio", [*given, begin], progress, python=request.python)
    coloured = "rgb" in planned["film"]
    if coloured:
        _require_engine(planned["engine"])
    notes = [
        f"{len(planned['shots'])} shots, {planned['pictures']} pictures, about {planned['needed_mb']:.0f} MiB on disk."
    ]
    progress(f"planned, {planned['needed_mb']:.0f} MiB", 1, 1)
    result: StudioResult = {**planned, "event": "result", "outputs": [str(request.out)], "notes": notes}
    if request.plan:
        return result
    if spread:
        result["notes"] += _by_workers(request, planned["shots"], coloured, progress)
    made: DataSetPlan = run_solver("studio", given, progress, python=request.python)
    if coloured and not spread:
        made = _in_colour(request, given, made, progress)
    outputs = [str(request.out), *made.get("card", ())]
    if request.benchmark or request.places:
        methods = ["--methods", *(request.benchmark or ("triangulation",))]
        more = ["--places"] if request.places else []
        more += ["--settings", str(request.settings)] if request.settings else []
        compared: BenchmarkResult = run_solver(
            "studio-benchmark", [str(request.out), *methods, *more], progress, python=request.python
        )
        outputs.append(compared["page"])
        result["page"], result["table"], result["rows"] = compared["page"], compared["table"], compared["rows"]
        if "places" in compared:
            result["places"] = compared["places"]
    result["outputs"], result["frames"] = outputs, made["frames"]
    result["seconds"] = round(time.monotonic() - start, 2)
    return result


def _by_workers(request: StudioRequest, shots: list[str], coloured: bool, progress: Progress) -> list[str]:
    """Make all shots by the workers, and return what a person should know about these."""
    work = Shots(request.description, request.out, digest_of(request.description), coloured, request.python)
    records: list[TakeRecord] = []
    with engine_for(work, progress, request.spread) as engine:
        items = Listed([work.item(name) for name in shots])
        dispatch(work, items, engine, progress, lambda record, recalled: records.append(record))
        notes = engine.notes()
    require_all(records, work.data_set)
    return notes


def _colour_of(request: StudioRequest, progress: Progress) -> CommandResult:
    from ..studio.data_set import film_data_set_in_colour, write_videos

    film_data_set_in_colour(request.out, [request.colour_of], 1, progress)
    if "video" in (read_json_file(request.description).get("write") or ()):  # the film has checked it
        write_videos(request.out, [request.colour_of], progress)
    return {"event": "result", "outputs": [str(request.out)], "notes": []}


def _in_colour(request: StudioRequest, given: list[str], made: DataSetPlan, progress: Progress) -> DataSetPlan:
    from ..studio.data_set import film_data_set_in_colour, write_videos

    film_data_set_in_colour(request.out, made["shots"], made["frames"], progress)
    if "video" in made["write"]:
        write_videos(request.out, made["shots"], progress)
    # Once more, for the card and the contact sheet: the shots are there.
    return run_solver("studio", given, progress, python=request.python)


def _require_engine(name: str) -> None:
    require_blender(instead="film no 'rgb'")
    from ..studio.colour_film import engine_id

    engine_id(name)
