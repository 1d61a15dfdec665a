"""``dataset make``: write captures with ground truth, and optionally evaluate a solve."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from .._exchange.cluster_address import use_certificates
from .._exchange.json_file import read_json_file
from .._exchange.progress import Progress
from .._exchange.verb_results import DataSetPlan
from .batch.dispatch import dispatch
from .batch.record import TakeRecord
from .batch.request import Listed, Spread
from .batch.run_batch import engine_for
from .batch.shots import Shots, digest_of, require_all
from .children import run_solver
from .process import require_blender
from .result import CommandResult


def run_studio(args: Namespace, progress: Progress) -> CommandResult:
    """Make a data set. An interrupted run can be resumed.

    The solver renders ground truth, infrared, depth and masks, and Blender renders the colour images. The result
    contains the folder, shots, frames, pictures, seconds, and the table printed by ``dataset benchmark``.
    """
    if args.tls is not None:
        use_certificates(args.tls)
    if args.colour_of:
        wanted = read_json_file(args.description).get("write") or ()  # was checked when the shot was filmed
        _film_in_colour(args.out, [args.colour_of], 1, "video" in wanted, progress)
        return {"outputs": [str(args.out)], "notes": []}
    words = [str(args.description), "--out", str(args.out)]
    spread = bool(args.scheduler or args.workers)
    begin = "--claim" if spread and not args.plan else "--plan"
    planned: DataSetPlan = run_solver("dataset make", [*words, begin], progress, python=args.python)
    coloured = "rgb" in planned["film"]
    if coloured:
        require_blender(instead="film no 'rgb'")
        from ..studio.colour_film import engine_id

        engine_id(planned["engine"])
    size = f"about {planned['needed_mb']:.0f} MiB on disk"
    notes = [f"{len(planned['shots'])} shots, {planned['pictures']} images, {size}."]
    result: CommandResult = {**planned, "outputs": [str(args.out)], "notes": notes}
    if args.plan:
        return result
    if spread:
        notes += _by_workers(args, planned["shots"], coloured, progress)
    made: DataSetPlan = run_solver("dataset make", words, progress, python=args.python)
    if coloured and not spread:
        _film_in_colour(args.out, made["shots"], made["frames"], "video" in made["write"], progress)
        # All shots exist now, so this run only makes the card and the contact sheet.
        made = run_solver("dataset make", words, progress, python=args.python)
    result["outputs"] += made.get("card", ())
    if args.benchmark or args.places:
        words = [str(args.out), "--methods", *(dict.fromkeys(args.benchmark) or ("triangulation",))]
        words += ["--places"] if args.places else []
        words += ["--settings", str(args.settings)] if args.settings else []
        compared = run_solver("dataset benchmark", words, progress, python=args.python)
        result["outputs"].append(compared["page"])
        result |= {key: compared[key] for key in ("page", "table", "rows", "places") if key in compared}
    result["frames"] = made["frames"]
    return result


def _by_workers(args: Namespace, shots: list[str], coloured: bool, progress: Progress) -> list[str]:
    """Let the workers process all shots, and return notes about the workers."""
    work = Shots(args.description, args.out, digest_of(args.description), coloured, args.python)
    records: list[TakeRecord] = []
    with engine_for(work, progress, Spread(args.scheduler, args.workers, patience_s=args.patience)) as engine:
        items = Listed([work.item(name) for name in shots])
        dispatch(work, items, engine, progress, lambda record, recalled: records.append(record))
        notes = engine.notes()
    require_all(records, work.data_set)
    return notes


def _film_in_colour(folder: Path, shots: list[str], frames: int, videos: bool, progress: Progress) -> None:
    from ..studio.colour_film import film_data_set_in_colour, write_videos

    film_data_set_in_colour(folder, shots, frames, progress)
    if videos:
        write_videos(folder, shots, progress)
