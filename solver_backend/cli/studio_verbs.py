"""Run the studio verbs: make data sets, compare solves, and predict camera errors."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from solver_backend.cli.outcome import Outcome, rows
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verb_results import BenchmarkResult, DataSetPlan
from solver_backend.io.files import read_json
from solver_backend.job import settings_of
from solver_backend.synthesis.studio import data_set
from solver_backend.synthesis.studio.benchmark.page import page_html, table
from solver_backend.synthesis.studio.benchmark.place_errors import place_errors, places_text
from solver_backend.synthesis.studio.benchmark.solve_and_compare import solve_and_compare
from solver_backend.synthesis.studio.contact_sheet import write_card
from solver_backend.synthesis.studio.spec import read_faults, read_spec


def studio(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Render a synthetic data set, or only report its size."""
    spec = read_spec(args.description)
    begin = data_set.open_data_set if args.claim else data_set.check_data_set
    found = begin(spec, args.out) if args.plan or args.claim else data_set.plan(spec)
    needed, free = found.bytes / 2**20, data_set.free_bytes(args.out) / 2**20
    data = DataSetPlan(
        shots=[shot.name for shot in found.shots], frames=found.frames, pictures=found.pictures,
        needed_mb=round(needed, 1), film=list(spec.film), engine=spec.rgb.engine, write=list(spec.write),
        data_set=str(args.out), free_mb=round(free, 1),
    )  # fmt: skip
    if args.plan or args.claim:
        message = f"{len(found.shots)} shots, {found.frames} frames, {found.pictures} images, {needed:.0f} MiB"
        return Outcome(f"would make at most {message}", data)
    records = data_set.make_data_set(spec, args.out, progress, args.shot)
    data["frames"] = sum(record["frames"] for record in records)
    made = f"made {len(records)} of {len(found.shots)} shots, {data['frames']} frames"
    if data["frames"] < spec.frames * len(records):  # a motion is shorter than requested
        made += f" of {spec.frames * len(records)} requested, because some motions are shorter"
    if args.shot:
        return Outcome(made, data)
    card = write_card(args.out)
    return Outcome("\n".join([made, *rows("written", args.out)]), {**data, "card": [str(path) for path in card]})


def studio_benchmark(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Solve a data set by several methods, compare the motions with the ground truth, and write a page."""
    spec, _ = data_set.read_data_set(args.data_set)
    settings = SolveSettings() if args.settings is None else _settings(args.settings)
    verdicts = solve_and_compare(args.data_set, args.methods, args.inputs, args.faults, progress, settings)
    places = [place_errors(array, spec.perturb, progress=progress) for array in spec.arrays] if args.places else []
    page = args.data_set / "benchmark.html"
    write_text(page, page_html(args.data_set, spec.name, verdicts, places), overwrite=True)
    figures = ("mpjpe_mm", "pa_mpjpe_mm", "accel_m_s2", "seconds")
    names = {"shot": "shot", "camera_array": "array", "faults": "faults", "input": "source", "method": "method"}
    plain = [
        {key: getattr(verdict, name) for key, name in {**names, "error": "error"}.items()}
        | {name: round(getattr(verdict, name), 4) for name in figures}
        for verdict in verdicts
    ]
    data: BenchmarkResult = {"page": str(page), "table": table(verdicts), "rows": plain}
    if places:
        data["places"] = str(write_text(args.data_set / "places.json", places_text(places), overwrite=True))
    return Outcome("\n".join([data["table"], *rows("written", page)]), data)


def studio_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Map the expected error of each camera array over the floor."""
    spec = read_spec(args.description)
    faults = {f", {name}": read_faults(name) for name in args.faults} or {"": spec.perturb}
    places = [
        replace(place_errors(array, given, seed=spec.seed, progress=progress), array=f"{array.name}{suffix}")
        for array in spec.arrays
        for suffix, given in faults.items()
    ]
    write_text(args.out, page_html(args.out.parent, spec.name, (), places), overwrite=args.overwrite)
    medians = {p.array: p.median_mm for p in places}
    shown = {name: "no person located" if value is None else f"{value:6.1f} mm" for name, value in medians.items()}
    return Outcome("\n".join(f"{name:<32} {value}" for name, value in shown.items()), {"median_mm": medians})


def _settings(path: Path) -> SolveSettings:
    values = read_json(path)
    if not isinstance(values, dict):
        raise JobInvalid("The settings must be a JSON object.", where=str(path), hint='For example {"smoothing": 2.0}.')
    return settings_of(values, path.resolve().parent)
