"""The verbs. What they call is imported inside them: ``--help`` and a wrong path answer at once."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from solver_backend.cli.arguments import given_settings
from solver_backend.cli.describe import describe_capture, describe_people, people_lines
from solver_backend.cli.describe_markers import describe_person
from solver_backend.cli.outcome import Outcome
from solver_backend.cli.reading import load, loaded, reading, trials_of
from solver_backend.exchange.diagnostics import diagnostic, sentence
from solver_backend.exchange.errors import (
    BackendMissing,
    CaptureNotRecognised,
    CommandLineInvalid,
    MarkersUnknown,
    RefinementUseless,
)
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verb_results import CameraChange, CaptureResult, CapturesResult, PersonResult, RefineResult
from solver_backend.io.footage import SENSOR_RECORDING
from solver_backend.types import Capture

if TYPE_CHECKING:
    from training.engine.publish import Finished


def calibrate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Learn a person from one or several marker takes and write the subject file."""
    overwrite = args.overwrite
    captures = [load(path, reading(args), progress) for path in args.captures]
    from solver_backend.fitters.label_after import person_of_nameless
    from solver_backend.fitters.label_first import labelled_capture
    from solver_backend.fitters.pipeline import calibrate_person
    from solver_backend.io.native.motion_file import write_subject

    settings = SolveSettings.from_dict(given_settings(args))
    nameless = list[Capture]()
    if args.layout is None:
        labelled = [labelled_capture(capture, progress) for capture in captures]
        captures = [capture for capture, _ in labelled]
        nameless = [capture for capture, take in labelled if take is not None]
    person = calibrate_person(captures, settings, progress)
    person = person_of_nameless(person, nameless, settings, progress)
    write_subject(args.out, person, overwrite=overwrite)
    text, data = describe_person(person)
    problems = [sentence(item) for capture in captures for item in capture.problems]
    written: PersonResult = {"subject": str(args.out), **data, "problems": problems}
    return Outcome(f"{text}\n  written     {args.out}", written)


def layout(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write which place each marker's label is taken for, as a file to be edited."""
    overwrite = args.overwrite
    capture = load(args.capture, reading(args), progress)
    if capture.markers is None or capture.markers.labels is None:
        raise MarkersUnknown("The capture has no labelled markers.", where=capture.name, hint="Choose a labelled take.")
    from solver_backend.body.label_places import write_label_places

    write_label_places(args.out, capture.markers.labels, overwrite=overwrite)
    text, data = describe_capture(capture)
    return Outcome(f"{text}\n  written     {args.out}", {"layout": str(args.out), **data})


def info(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Report what a capture holds, what the reader assumed and what is wrong with it."""
    capture = loaded(args, progress)
    text, data = describe_capture(capture)
    if args.report is None:
        return Outcome(text, data)
    from solver_backend.report.capture_page import write_capture_report

    write_capture_report(args.report, capture, overwrite=args.overwrite)
    return Outcome(f"{text}\n  page        {args.report}", {**data, "report": str(args.report)})


def people(args: argparse.Namespace, progress: Progress) -> Outcome:
    """List everybody that two or more views see."""
    capture = load(args.capture, reading(args), progress)
    found = describe_people(capture)
    lines = people_lines(found) or ["  one person"]
    return Outcome("\n".join([f"Capture {capture.name}", *lines]), {"name": capture.name, "people": found})


def convert(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write any capture as one of our own files, or each trial of a session as one of its own.

    A folder of videos becomes a capture by the default detector, a recording of sensors by finding its markers.
    """
    overwrite = args.overwrite
    trials = trials_of(args.capture)
    if not trials:
        check_output(args.out, overwrite=overwrite)
        return Outcome(*_write(args.out, _converted(args, progress), overwrite))
    if args.out.suffix.lower() == ".npz":
        raise CommandLineInvalid(
            "The capture is a session of several trials.", where=str(args.capture), hint="Name a folder with --out."
        )
    files = [args.out / trial.name / "capture.npz" for trial in trials]
    for path in files:
        check_output(path, overwrite=overwrite)
    texts: list[str] = []
    found: CapturesResult = {"captures": []}
    for trial, path in zip(trials, files, strict=True):
        text, data = _write(path, load(trial, reading(args), progress), overwrite)
        texts.append(text)
        found["captures"].append({**data, "source": str(trial)})
    return Outcome("\n".join(texts), found)


def _converted(args: argparse.Namespace, progress: Progress) -> Capture:
    try:
        return load(args.capture, reading(args), progress)
    except CaptureNotRecognised:
        if (args.capture / SENSOR_RECORDING).is_file():
            from solver_backend.sensors.devices.recorded import open_folder
            from solver_backend.sensors.take import capture_of

            return capture_of(open_folder(args.capture), progress=progress)
        from solver_backend.cli.video_verbs import capture_of_folder

        capture = capture_of_folder(args.capture, args.out.parent, progress)
        if capture is None:
            raise
        return capture


def refine_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Correct camera poses by the people they film, and write the capture with them."""
    overwrite = args.overwrite
    capture = load(args.capture, reading(args), progress)
    from solver_backend.cameras.refinement import refine_calibration

    progress("Refining the cameras", 0, 1)
    found = refine_calibration(capture)
    progress("Refining the cameras", 1, 1)
    before, after = float(np.nanmedian(found.before_px)), float(np.nanmedian(found.after_px))
    if not found.is_better:
        raise RefinementUseless(
            f"The cameras fit the people no better when refined: {before:.1f} px before, {after:.1f} px after.",
            where=capture.name, hint="The calibration is as good as the detections can show; keep it.",
        )  # fmt: skip
    note = diagnostic("cameras_refined", before=before, after=after)
    problems = tuple(problem for problem in capture.problems if problem.code != "cameras_shifted")
    refined = replace(capture, cameras=found.cameras, notes=(*capture.notes, note), problems=problems)
    text, data = _write(args.out, refined, overwrite)
    rows: list[CameraChange] = [
        {
            "name": name, "before_px": _rounded(found.before_px[c]), "after_px": _rounded(found.after_px[c]),
            "moved_mm": _rounded(found.moved_mm[c]), "turned_degrees": _rounded(found.turned_degrees[c]),
        }
        for c, name in enumerate(found.cameras.names)
    ]  # fmt: skip
    lines = [
        f"  refined     {row['name']}: {row['before_px']} px before, {row['after_px']} px after; "
        f"moved by {row['moved_mm']} mm, turned by {row['turned_degrees']}°"
        for row in rows
    ]
    done: RefineResult = {**data, "refined": rows}
    return Outcome("\n".join([text, *lines]), done)


def _rounded(value: float) -> float | None:
    return round(float(value), 2) if np.isfinite(value) else None


def bodies(args: argparse.Namespace, progress: Progress) -> Outcome:
    """List the bodies that can be chosen by name, and the folder they are looked for in."""
    from solver_backend.body.files.choices import list_bodies
    from solver_backend.exchange.body_choice import bodies_folder

    found = {body.name: str(body.path) for body in list_bodies()}
    width = max(map(len, found))
    lines = [f"  {name:<{width}}  {path}" for name, path in found.items()]
    text = "\n".join(["Bodies", *lines, f"Body files in {bodies_folder()} are choices, too."])
    return Outcome(text, {"bodies": found, "folder": str(bodies_folder())})


def demo_capture(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write the embedded synthetic capture, truth included, or the embedded take of markers."""
    overwrite = args.overwrite
    if args.markers:
        from solver_backend.synthesis.embedded.demo import DEMO_TAKE

        return Outcome(*_write(args.out, load(DEMO_TAKE, {}, progress), overwrite))
    from solver_backend.synthesis.embedded.demo import demo_capture as make_capture

    return Outcome(*_write(args.out, make_capture(), overwrite))


def evaluate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Compare a motion with the truth of a synthetic capture; of views, beside triangulation and a low-pass filter."""
    from solver_backend.evaluation.evaluate import evaluate as compare
    from solver_backend.io.native.motion_file import read_motion

    capture = load(args.capture, {}, progress)
    found = compare(capture, read_motion(args.motion))
    return Outcome("\n".join(found.lines()), found.figures())


def train(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Train a prior and write its weights and model card."""
    try:
        from training.engine.loop import TrainingSettings
        from training.train import train as train_prior
    except ModuleNotFoundError as error:
        raise training_missing(error) from error
    if args.prior == "landmarks":
        return _train_landmarks(args, progress)
    names = ("steps", "batch", "learning_rate", "part", "device", "workers")
    chosen = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    options = {"seed": args.seed, "hidden": args.hidden, "start": args.start, "work": args.work}
    settings = TrainingSettings(**chosen)
    finished = train_prior(args.prior, args.data, args.out, settings=settings, progress=progress, **options)
    figures = {name: round(value, 4) for name, value in finished.metrics.items()}
    lines = [f"  {name:<30} {value:.4g}" for name, value in figures.items()]
    return _trained(finished, lines, figures)


def training_missing(error: ModuleNotFoundError, libraries: str = "torch scipy") -> BackendMissing:
    """Return the error that names what a verb that trains lacks: the repository's own package, or a library."""
    if str(error.name).partition(".")[0] == "training":
        return BackendMissing("The extension does not train.", hint="Run this verb in a clone of the repository.")
    return BackendMissing(
        f"Training needs the package {error.name}, which is not installed.",
        hint=f"Install the libraries with: pip install {libraries}.",
    )


def _train_landmarks(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Train a row of the landmark networks, by steps or by seconds."""
    from training.landmarks.loop import LandmarkTraining
    from training.landmarks.train import train_landmark_rows

    names = ("steps", "seconds", "batch", "learning_rate", "device")
    chosen = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    settings = LandmarkTraining(seed=args.seed, graph=args.device == "cuda", processor=args.processor, **chosen)
    finished = train_landmark_rows(
        args.data, args.out, settings, row=args.row, width=args.width, resolution=args.resolution, work=args.work,
        start=args.start, balanced_by=args.balanced_by, progress=progress,
    )  # fmt: skip
    return _trained(finished, [], {name: round(value, 4) for name, value in finished.metrics.items()})


def _trained(finished: Finished, lines: list[str], figures: dict[str, float]) -> Outcome:
    """Return the weights' path and figures, and which held-out subjects these are without."""
    if finished.absent:
        lines = [f"  held-out subjects not among the recordings: {', '.join(finished.absent)}", *lines]
    data = {"weights": str(finished.weights), "absent_subjects": list(finished.absent), **figures}
    return Outcome("\n".join([str(finished.weights), *lines]), data)


def _write(path: Path, capture: Capture, overwrite: bool) -> tuple[str, CaptureResult]:
    from solver_backend.io.native.capture_file import write_capture

    write_capture(path, capture, overwrite=overwrite)
    text, data = describe_capture(capture)
    return f"{text}\n  written     {path}", {"capture": str(path), **data}
