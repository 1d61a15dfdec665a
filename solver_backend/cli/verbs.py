"""The verbs. What they call is imported inside them: ``--help`` and a wrong path answer at once."""

from __future__ import annotations

import argparse
import time
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from solver_backend.cli.describe import describe_capture, describe_motion
from solver_backend.cli.describe_markers import describe_person
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import BackendMissing, CaptureNotRecognised, CommandLineInvalid, MarkersUnknown
from solver_backend.exchange.outputs import atomic_output, check_output
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.settings import SolveSettings
from solver_backend.job import READING, Job, Resolve, joint_set_named, positive_fps
from solver_backend.types import Capture, Motion


def solve(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Solve a capture, write the motion and, if asked for, the report."""
    job = _job(args)
    for path in (job.out, job.report):
        if path is not None:
            check_output(path, overwrite=job.overwrite)
    capture = _load(job.capture, job.reading(), progress)
    from solver_backend.fitters.pipeline import resolve_range
    from solver_backend.fitters.pipeline import solve as solve_capture
    from solver_backend.io.native.motion_file import read_motion
    from solver_backend.io.native.subject_file import read_subject
    from solver_backend.io.recognition.motion_checks import motion_problems

    start = time.monotonic()
    if job.resolve is None:
        person = None if job.subject is None else read_subject(job.subject)
        motion = solve_capture(capture, job.settings, progress, person=person).motion
    else:
        earlier = read_motion(job.resolve.motion)
        motion = resolve_range(capture, earlier, job.resolve.stretch, job.settings, progress).motion
    solve_s = time.monotonic() - start
    timed = replace(motion, provenance={**motion.provenance, "solve_s": round(solve_s, 2)})
    _write_both(job, capture, timed, progress)
    text, data = describe_motion(timed, solve_s)
    odd = motion_problems(timed)
    text += "".join(f"\n  problem     {problem}" for problem in odd)
    written = {"motion": str(job.out), "report": None if job.report is None else str(job.report)}
    files = "".join(f"\n  {name:<11} {path}" for name, path in written.items() if path)
    return Outcome(text + files, {**written, **data, "problems": [*capture.problems, *odd]})


def _write_both(job: Job, capture: Capture, motion: Motion, progress: Progress) -> None:
    """Write the motion and its report, named one right after the other; the motion also where the report fails."""
    from solver_backend.io.native.motion_file import write_motion
    from solver_backend.report.page import report_html

    with ExitStack() as named_last:
        try:
            if job.report is not None:
                progress("Writing the report", 0, 1)
                page = named_last.enter_context(atomic_output(job.report, overwrite=job.overwrite))
                page.write_text(report_html(capture, motion), encoding="utf-8", newline="\n")
                progress("Writing the report", 1, 1)
        finally:
            write_motion(job.out, motion, overwrite=job.overwrite)


def calibrate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Learn a person from one or several marker takes and write the subject file."""
    overwrite = bool(args.overwrite)
    check_output(args.out, overwrite=overwrite)
    captures = [_load(path, _reading(args), progress) for path in args.captures]
    from solver_backend.fitters.pipeline import calibrate_person
    from solver_backend.io.native.subject_file import write_subject

    chosen = {name: getattr(args, name) for name in ("body", "layout") if getattr(args, name) is not None}
    settings = SolveSettings.from_dict(chosen)
    person = calibrate_person(captures, settings, progress)
    write_subject(args.out, person, overwrite=overwrite)
    text, data = describe_person(person)
    problems = [problem for capture in captures for problem in capture.problems]
    return Outcome(f"{text}\n  written     {args.out}", {"subject": str(args.out), **data, "problems": problems})


def layout(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write which place each marker's label is taken for, as a file to be edited."""
    overwrite = bool(args.overwrite)
    check_output(args.out, overwrite=overwrite)
    capture = _read(args, progress)
    if capture.markers is None or capture.markers.labels is None:
        raise MarkersUnknown("The capture has no labelled markers.", where=capture.name, hint="Choose a labelled take.")
    from solver_backend.body.label_places import write_label_places

    write_label_places(args.out, capture.markers.labels, overwrite=overwrite)
    text, data = describe_capture(capture)
    return Outcome(f"{text}\n  written     {args.out}", {"layout": str(args.out), **data})


def info(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Say what a capture holds, what the reader assumed and what is wrong with it."""
    text, data = describe_capture(_read(args, progress))
    return Outcome(text, data)


def convert(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write any capture as one of our own files; a folder of videos becomes one by the default detector."""
    overwrite = bool(args.overwrite)
    check_output(args.out, overwrite=overwrite)
    try:
        capture = _read(args, progress)
    except CaptureNotRecognised:
        from solver_backend.cli.video_verbs import capture_of_folder

        capture = capture_of_folder(args.capture, args.out.parent, progress)
        if capture is None:
            raise
    return _write(args.out, capture, overwrite)


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
    overwrite = bool(args.overwrite)
    check_output(args.out, overwrite=overwrite)
    if args.markers:
        from solver_backend.synthetic.marker_demo import DEMO_TAKE

        return _write(args.out, _load(DEMO_TAKE, {}, progress), overwrite)
    from solver_backend.synthetic.demo import demo_capture as make_capture

    return _write(args.out, make_capture(), overwrite)


def evaluate(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Compare a motion with the truth of a synthetic capture, beside triangulation and a low-pass filter."""
    from solver_backend.evaluation.evaluate import evaluate as compare
    from solver_backend.io.native.motion_file import read_motion

    capture = _load(args.capture, {}, progress)
    found = compare(capture, read_motion(args.motion))
    ratios = {"mpjpe_ratio": found.mpjpe_ratio, "accel_ratio": found.accel_ratio}
    figures = {name: round(value, 4) for name, value in {**asdict(found), **ratios}.items()}
    return Outcome("\n".join(found.lines()), figures)


def train(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Train a prior and write its weights and model card."""
    try:
        from solver_backend.training.engine.loop import TrainingSettings
        from solver_backend.training.train import train as train_prior
    except ModuleNotFoundError as error:
        raise BackendMissing(
            f"Training needs the package {error.name}, which is not installed.",
            hint="pip install manifold-mocap[train]",
        ) from error
    names = ("steps", "batch", "learning_rate", "part", "device")
    chosen = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    options = {"seed": args.seed, "hidden": args.hidden, "start": args.start, "work": args.work}
    settings = TrainingSettings(**chosen)
    finished = train_prior(args.prior, args.data, args.out, settings=settings, progress=progress, **options)
    figures = {name: round(value, 4) for name, value in finished.metrics.items()}
    lines = [f"  {name:<30} {value:.4g}" for name, value in figures.items()]
    return Outcome("\n".join([str(finished.weights), *lines]), {"weights": str(finished.weights), **figures})


def _job(args: argparse.Namespace) -> Job:
    """Return the job of the command line: a job file, or the options that would stand in one."""
    files, chosen = ("capture", "out", "report", "subject", "overwrite"), ("method", "backend", "body", "layout")
    names = (*files, *READING, *chosen, "resolve", "frames")
    given = [name for name in names if getattr(args, name) is not None]
    if args.job is not None:
        if given:
            raise CommandLineInvalid(
                f"--job cannot be combined with {', '.join(given)}.", hint="Write it into the job file."
            )
        return Job.read(args.job)
    if args.capture is None or args.out is None:
        raise CommandLineInvalid("solve needs a capture and --out, or --job.", hint="solve CAPTURE --out MOTION.npz")
    return Job(
        capture=args.capture,
        out=args.out,
        report=args.report,
        subject=args.subject,
        overwrite=bool(args.overwrite),
        **_reading(args),
        settings=SolveSettings.from_dict({name: getattr(args, name) for name in chosen if name in given}),
        resolve=_resolve(args),
    )


def _resolve(args: argparse.Namespace) -> Resolve | None:
    if args.resolve is None and args.frames is None:
        return None
    if args.resolve is None or args.frames is None:
        raise CommandLineInvalid(
            "--resolve and --frames belong together.", hint="--resolve MOTION.npz --frames FIRST LAST"
        )
    return Resolve(args.resolve, FrameRange(*args.frames))


def _read(args: argparse.Namespace, progress: Progress) -> Capture:
    return _load(args.capture, _reading(args), progress)


def _reading(args: argparse.Namespace) -> dict[str, Any]:
    """Return the options that say how a capture is read."""
    return {
        "fps": None if args.fps is None else positive_fps(args.fps),
        "trim": bool(args.trim),
        "joint_set": None if args.joint_set is None else joint_set_named(args.joint_set),
        "unit": args.unit,
        "up_axis": args.up_axis,
        "subject_prefix": args.subject_prefix,
    }


def _load(path: Path, reading: dict[str, Any], progress: Progress) -> Capture:
    from solver_backend.io.load import load_capture

    return load_capture(path, **reading, progress=progress)


def _write(path: Path, capture: Capture, overwrite: bool) -> Outcome:
    from solver_backend.io.native.capture_file import write_capture

    write_capture(path, capture, overwrite=overwrite)
    text, data = describe_capture(capture)
    return Outcome(f"{text}\n  written     {path}", {"capture": str(path), **data})
