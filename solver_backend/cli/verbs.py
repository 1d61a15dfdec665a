"""Run the capture verbs. Each verb imports what it needs, so that the program starts quickly."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.cli.arguments import given_settings, load, loaded, reading, trials_of
from solver_backend.cli.describe import describe_capture
from solver_backend.cli.outcome import Outcome, rows, sentences
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CaptureNotRecognised, CommandLineInvalid, MarkersUnknown, RefinementUseless
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verb_results import CaptureResult, RefineResult
from solver_backend.io.footage import SENSOR_RECORDING
from solver_backend.types import Capture


def calibrate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Calibrate a person from marker takes, and write the subject file."""
    captures = [load(path, reading(args), progress) for path in args.captures]
    from solver_backend.cli.describe_markers import describe_person
    from solver_backend.fitters.label_after import person_of_nameless
    from solver_backend.fitters.label_first import labelled_capture
    from solver_backend.fitters.pipeline import calibrate_person
    from solver_backend.io.native.motion_file import write_subject

    settings, nameless = SolveSettings.from_dict(given_settings(args)), list[Capture]()
    if args.layout is None:
        labelled = [labelled_capture(capture, progress) for capture in captures]
        captures = [capture for capture, _ in labelled]
        nameless = [capture for capture, take in labelled if take is not None]
    person = person_of_nameless(calibrate_person(captures, settings, progress), nameless, settings, progress)
    write_subject(args.out, person, overwrite=args.overwrite)
    text, data = describe_person(person)
    problems = sentences([item for capture in captures for item in capture.problems])
    return Outcome(text, {**data, "problems": problems})


def layout(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a layout file with the body landmark of each marker label, for the user to edit."""
    capture = loaded(args, progress)
    if capture.markers is None or capture.markers.labels is None:
        raise MarkersUnknown("The capture has no labelled markers.", where=capture.name, hint="Choose a labelled take.")
    from solver_backend.body.label_places import write_label_places

    write_label_places(args.out, capture.markers.labels, overwrite=args.overwrite)
    return Outcome(*describe_capture(capture))


def info(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Report a capture's contents, the assumptions made in reading it, and its problems."""
    capture = loaded(args, progress)
    text, data = describe_capture(capture)
    if args.report is None:
        return Outcome(text, data)
    from solver_backend.report.capture_page import write_capture_report

    write_capture_report(args.report, capture, overwrite=args.overwrite)
    return Outcome("\n".join([text, *rows("page", args.report)]), {**data, "report": str(args.report)})


def convert(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Convert a capture, or each trial of a session, to our format.

    Videos in a folder are processed with the default detector. A sensor recording becomes a marker capture.
    """
    trials = trials_of(args.capture)
    if not trials:
        if args.out.suffix.lower() != ".npz":
            hint = f"--out {args.out.with_suffix('.npz')}" if args.out.name else "Use a name that ends in .npz."
            raise CommandLineInvalid("The name of a capture file must end in .npz.", where=str(args.out), hint=hint)
        check_output(args.out, overwrite=args.overwrite)
        return Outcome(*_write(args.out, _converted(args, progress), args.overwrite))
    if args.out.suffix.lower() == ".npz":
        raise CommandLineInvalid(
            "The capture is a session with several trials.", where=str(args.capture), hint="Use a folder for --out."
        )
    files = [args.out / trial.name / "capture.npz" for trial in trials]
    for path in files:
        check_output(path, overwrite=args.overwrite)
    loaded_trials = ((path, load(trial, reading(args), progress)) for trial, path in zip(trials, files, strict=True))
    written = [_write(path, capture, args.overwrite) for path, capture in loaded_trials]
    found = [{**data, "source": str(trial)} for trial, (_, data) in zip(trials, written, strict=True)]
    return Outcome("\n".join(text for text, _ in written), {"captures": found})


def _converted(args: argparse.Namespace, progress: Progress) -> Capture:
    try:
        return loaded(args, progress)
    except CaptureNotRecognised:
        if (args.capture / SENSOR_RECORDING).is_file():
            from solver_backend.sensors.chain import capture_of
            from solver_backend.sensors.devices.recorded import open_folder

            return capture_of(open_folder(args.capture), progress=progress)
        from solver_backend.cli.video_verbs import capture_of_folder

        capture = capture_of_folder(args.capture, args.out.parent, progress)
        if capture is None:
            raise
        return capture


def refine_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Refine camera poses from the people in view, and write the capture with the new poses."""
    capture = loaded(args, progress)
    from solver_backend.cameras.refinement import refine_calibration

    progress("Refining the cameras", 0, 1)
    found = refine_calibration(capture)
    progress("Refining the cameras", 1, 1)
    before, after = float(np.nanmedian(found.before_px)), float(np.nanmedian(found.after_px))
    if not found.is_better:
        message = f"The refinement did not improve the cameras. Error: {before:.1f} px before, {after:.1f} px after."
        hint = "Keep the calibration."
        raise RefinementUseless(message, where=capture.name, hint=hint)
    note = diagnostic("cameras_refined", before=before, after=after)
    problems = tuple(problem for problem in capture.problems if problem.code != "cameras_shifted")
    refined = replace(capture, cameras=found.cameras, notes=(*capture.notes, note), problems=problems)
    text, data = _write(args.out, refined, args.overwrite)
    changes = []
    for c, name in enumerate(found.cameras.names):
        columns = {key: getattr(found, key)[c] for key in ("before_px", "after_px", "moved_mm", "turned_degrees")}
        values = {key: round(float(value), 2) if np.isfinite(value) else None for key, value in columns.items()}
        changes.append({"name": name, **values})
        line = "{before_px} px before, {after_px} px after, moved by {moved_mm} mm, rotated by {turned_degrees}°"
        text = "\n".join([text, *rows("refined", f"{name}: {line.format(**values)}")])
    done: RefineResult = {**data, "refined": changes}
    return Outcome(text, done)


def bodies(args: argparse.Namespace, progress: Progress) -> Outcome:
    """List the bodies that can be chosen by name, and the folder for the user's body files."""
    from solver_backend.body.files.choices import list_bodies
    from solver_backend.exchange.body_choice import bodies_folder

    found = {body.name: str(body.path) for body in list_bodies()}
    width = max(map(len, found))
    lines = [f"  {name:<{width}}  {path}" for name, path in found.items()]
    text = "\n".join(["Bodies", *lines, f"You can also choose body files in {bodies_folder()}."])
    return Outcome(text, {"bodies": found, "folder": str(bodies_folder())})


def demo_capture(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write the simulated demo capture with its ground truth, or the demo marker recording."""
    if args.markers:
        from solver_backend.synthesis.embedded.demo import DEMO_TAKE, record_markers

        take = replace(load(DEMO_TAKE, {}, progress), truth=record_markers().truth)
        return Outcome(*_write(args.out, take, args.overwrite))
    from solver_backend.synthesis.embedded.demo import demo_capture as make_capture

    return Outcome(*_write(args.out, make_capture(), args.overwrite))


def evaluate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Compare a motion with the ground truth and, if there are views, with triangulated keypoints."""
    from solver_backend.evaluation.evaluate import evaluate as compare
    from solver_backend.io.native.motion_file import read_motion

    options = {} if args.frames is None else {"frames": tuple(args.frames)}
    found = compare(load(args.capture, options, progress), read_motion(args.motion))
    return Outcome("\n".join(found.lines()), found.figures())


def _write(path: Path, capture: Capture, overwrite: bool) -> tuple[str, CaptureResult]:
    from solver_backend.io.native.capture_file import write_capture

    write_capture(path, capture, overwrite=overwrite)
    text, data = describe_capture(capture)
    return "\n".join([text, *rows("written", path)]), {"capture": str(path), **data}
