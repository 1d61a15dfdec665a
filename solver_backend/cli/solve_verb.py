"""Run the verb ``solve``: solve one motion, or several people, jobs or trials in sequence."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solver_backend.cli.arguments import EVERYBODY, given_settings, load, reading, trials_of
from solver_backend.cli.describe import describe_motion
from solver_backend.cli.outcome import Outcome, rows
from solver_backend.exchange.cluster_address import use_certificates
from solver_backend.exchange.diagnostics import Diagnostic, notes_in, refuse_errors, sentence, summarise, warnings_in
from solver_backend.exchange.errors import Cancelled, CommandLineInvalid, MocapError, OutputExists, WarningsRefused
from solver_backend.exchange.job_file import MOTION_SUFFIX, start_of
from solver_backend.exchange.motion_file import is_motion
from solver_backend.exchange.outputs import atomic_files, check_output
from solver_backend.exchange.progress import Progress, prefixed
from solver_backend.exchange.setting import is_list
from solver_backend.exchange.solve_settings import GLOBAL, SolveSettings
from solver_backend.exchange.verb_results import SolveResult, TakeResult, TakesResult
from solver_backend.exchange.verbs import VERBS
from solver_backend.fitters.freed_memory import keep_freed_memory
from solver_backend.job import Job, Resolve
from solver_backend.types import Capture, Motion

if TYPE_CHECKING:
    from solver_backend.fitters.keyframes.optimise import Stretches
    from solver_backend.types.network_result import StartingResult


def solve(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Solve one or more captures, and write the motions and the requested reports."""
    jobs = _jobs(args)
    keep_freed_memory()
    if len(jobs) > 1 or jobs[0].person == EVERYBODY:
        with _stretches(args.scheduler, args.tls) as each:
            return _several(jobs, progress, each)
    job = jobs[0]
    _check(job)
    if job.resolve is not None and is_motion(job.capture):
        return _resolve_alone(job, progress)
    with _stretches(args.scheduler, args.tls) as each:
        return _solve_one(job, load(job.capture, job.reading(), progress), progress, each)


@contextmanager
def _stretches(scheduler: str | None, tls: Path | None) -> Iterator[Stretches]:
    """Yield a function that solves the segments of a long take, in this process or on a cluster."""
    from solver_backend.fitters.keyframes.optimise import in_turn

    if scheduler is None:
        yield in_turn
        return
    from solver_backend.cli.spread import ClusterStretches

    if tls is not None:
        use_certificates(tls)
    cluster = ClusterStretches(scheduler)
    try:
        yield cluster
    finally:
        cluster.close()


def _check(job: Job) -> None:
    for path in (job.out, job.report):
        if path is not None:
            check_output(path, overwrite=job.overwrite)


def _resolve_alone(job: Job, progress: Progress) -> Outcome[SolveResult]:
    """Solve frames of a motion again from the measurements stored in a motion file."""
    from solver_backend.cli.motion_reading import any_motion
    from solver_backend.fitters.pipeline import resolve_motion
    from solver_backend.io.motions.motion_checks import check_motion
    from solver_backend.io.native.motion_file import write_motion
    from solver_backend.report.checks import by_gravity, recorded_diagnostics

    assert job.resolve is not None
    if job.report is not None:
        raise CommandLineInvalid("A report needs the motion's capture. Omit --report.", where=str(job.report))
    start = time.monotonic()
    measured, earlier = any_motion(job.capture, job.settings.body), any_motion(job.resolve.motion, job.settings.body)
    motion = resolve_motion(measured, earlier, job.resolve, job.settings, progress).motion
    solve_s = time.monotonic() - start
    found = by_gravity([*recorded_diagnostics(motion), *check_motion(motion)])
    return _finish(job, motion, found, solve_s, lambda done: write_motion(job.out, done, overwrite=job.overwrite))


def _solve_one(
    job: Job, capture: Capture, progress: Progress, each: Stretches, others: Sequence[Motion] = ()
) -> Outcome[SolveResult]:
    from solver_backend.exchange.clips import require_own_frames
    from solver_backend.fitters.label_first import labelled_capture, named_points
    from solver_backend.fitters.pipeline import resolve_range
    from solver_backend.fitters.pipeline import solve as solve_capture
    from solver_backend.io.native.motion_file import read_motion, read_subject
    from solver_backend.io.native.user_labels_file import read_user_labels
    from solver_backend.labelling.position_network import chosen_network
    from solver_backend.report.checks import diagnose

    start = time.monotonic()
    take, own, given = None, capture.markers, dict[tuple[int, int], str]()
    network = chosen_network(job.settings.network) if job.settings.network else None
    if job.labels is not None:
        if job.settings.is_direct:
            message = "User labels cannot be combined with --landmarks."
            raise CommandLineInvalid(message, where=str(job.labels))
        if own is None:
            raise CommandLineInvalid("User labels need a marker recording.", where=str(job.labels))
        given = read_user_labels(job.labels, own)
        capture, take = labelled_capture(capture, progress, user_labels=given, network=network, always=True)
    elif not (job.settings.layout or job.settings.is_direct):
        capture, take = labelled_capture(capture, progress, network=network)
    if job.resolve is None:
        person = None if job.subject is None else read_subject(job.subject)
        if person is not None and take is not None:
            from solver_backend.fitters.label_after import labelled_as_person

            kept = {*given.values(), *(named_points(own).values() if own is not None else ())}
            capture = labelled_as_person(capture, person, job.settings, progress, kept=kept)
        begun, results = _starts(job, progress)
        solution = solve_capture(
            capture, job.settings, progress, person=person, start=begun, results=results, others=others, each=each
        )
        motion = solution.motion
    else:
        earlier = read_motion(job.resolve.motion)
        require_own_frames(earlier.provenance.get("edits") or (), str(job.resolve.motion))
        if job.person is None and capture.people and earlier.provenance.get("person"):
            capture = capture.of_person(earlier.provenance["person"])
        motion = resolve_range(capture, earlier, job.resolve, job.settings, progress).motion
    solve_s = time.monotonic() - start
    found = diagnose(capture, motion)
    outcome = _finish(job, motion, found, solve_s, lambda done: _write_both(job, capture, done, progress))
    if capture.person:
        outcome.data["person"] = capture.person
    return outcome


def _starts(job: Job, progress: Progress) -> tuple[Motion | None, list[StartingResult]]:
    """Read the earlier motion and the network results from which the solve starts."""
    if not job.start_from:
        return None, []
    from solver_backend.cli.motion_reading import network_of_bvh
    from solver_backend.io.motions.network_results import is_network_result, read_network_result
    from solver_backend.io.native.motion_file import read_motion
    from solver_backend.types.network_result import StartingResult

    begun, results = None, list[StartingResult]()
    for text in job.start_from:
        camera, file = start_of(text)
        if is_network_result(file):
            results.append(StartingResult(read_network_result(file), str(file), camera))
        elif file.suffix.lower() == ".bvh":
            results.append(StartingResult((network_of_bvh(file, job.settings.body, progress),), str(file), camera))
        elif begun is None:
            begun = read_motion(file)
        else:
            hint = "Specify one motion. You can specify several network results."
            raise CommandLineInvalid("Only one earlier motion can be used as the start.", where=text, hint=hint)
    return begun, results


def _finish(
    job: Job, motion: Motion, found: Sequence[Diagnostic], solve_s: float, write: Callable[[Motion], object]
) -> Outcome[SolveResult]:
    """Write a motion including its diagnostics, and return the outcome.

    Raises:
        WarningsRefused: the job is strict, and the solve raised warnings.
    """
    found = refuse_errors(found, job.settings.accept, str(job.capture))
    warnings = [sentence(item, motion.fps) for item in warnings_in(found)]
    if job.strict and warnings:
        raise WarningsRefused(
            f"Not saved because of --strict and {len(warnings)} warning{'s' * (len(warnings) > 1)}: "
            + " ".join(warnings),
            where=str(job.capture),
            hint="Solve without --strict to see the result.",
        )
    record = {key: value for key, value in motion.provenance.items() if key != "findings"}
    record |= {"solve_s": round(solve_s, 2), "diagnostics": [item.as_dict() for item in found]}
    motion = replace(motion, provenance=record)
    write(motion)
    text, data = describe_motion(motion, solve_s)
    report = None if job.report is None else str(job.report)
    lines = [text, *rows("note", *(sentence(item, motion.fps) for item in notes_in(found))), *rows("motion", job.out)]
    result: SolveResult = {"motion": str(job.out), "report": report, **data, "diagnostics": record["diagnostics"]}
    lines += rows("report", report) if report else []
    return Outcome("\n".join(lines), result, tuple(summarise(found, motion.fps)))


def _write_both(job: Job, capture: Capture, motion: Motion, progress: Progress) -> None:
    """Write the motion and its report together. If the report fails, the motion is still written."""
    from solver_backend.io.native.motion_file import write_motion

    if job.report is None:
        write_motion(job.out, motion, overwrite=job.overwrite)
        return
    failure: BaseException | None = None
    try:
        with atomic_files([job.out, job.report], overwrite=job.overwrite) as (out, page):
            try:
                _write_page(page, job, capture, motion, progress)
            except BaseException as error:  # raised after the motion has been saved
                page.unlink(missing_ok=True)
                failure = error
            write_motion(out, motion, name=job.out.stem)
    except OutputExists:
        if not job.out.exists():  # otherwise, another program has created this file in the meantime
            write_motion(job.out, motion)
        raise
    if failure is not None:
        raise failure


def _write_page(page: Path, job: Job, capture: Capture, motion: Motion, progress: Progress) -> None:
    from solver_backend.camera_calibration.calibration_check import check_calibration
    from solver_backend.report.page import report_html

    progress("Writing the report", 0, 1)
    fit = None
    if job.resolve is None and capture.cameras is not None and capture.keypoints is not None:
        with suppress(MocapError):  # there may be too few common detections to compare the cameras
            fit = check_calibration(capture.cameras, capture.keypoints, progress)
    page.write_text(report_html(capture, motion, fit), encoding="utf-8", newline="\n")
    progress("Writing the report", 1, 1)


def _several(jobs: list[Job], progress: Progress, each: Stretches) -> Outcome[TakesResult]:
    """Solve jobs one by one, with all people if requested. A failed job does not stop the other jobs.

    In the result, ``takes`` lists the results of ``solve``. ``failed`` lists the capture, the person and the error of
    each failed solve. If all jobs fail, the first error is raised.
    """
    ended: list[tuple[Job, str, Outcome[SolveResult] | MocapError]] = []
    for number, job in enumerate(jobs):
        parts = _parts(job, progress)
        where = f"{number + 1} of {len(jobs)}: " if len(jobs) > 1 else ""
        while True:
            title = job.capture.name
            try:
                part = next(parts, None)
                if part is None:
                    break
                own, capture = part
                title = f"{capture.name}, {capture.person}" if capture.person else capture.name
                found = _solve_one(own, capture, prefixed(progress, f"{where}{title}: "), each)
                ended.append((own, title, found))
            except Cancelled:
                raise
            except MocapError as error:
                ended.append((job, title, error))
    for index, others in _meetings(ended):
        own, title, alone = ended[index]
        assert isinstance(alone, Outcome)
        step = prefixed(progress, f"{title}, with other people: ")
        try:
            capture = load(own.capture, own.reading(), step)
            if capture.several_views is not None:
                again = _solve_one(replace(own, overwrite=True), capture, step, each, others)
                ended[index] = own, title, again
        except Cancelled:
            raise
        except MocapError as error:
            line = f"warning: The joint solve of all people failed, so the separate solve is used: {error}"
            ended[index] = own, title, replace(alone, summary=(line, *alone.summary))
    texts: list[str] = []
    summary: list[str] = []
    to_check: list[str] = []
    takes: list[TakeResult] = []
    failed: list[dict[str, Any]] = []
    for job, title, outcome in ended:
        if isinstance(outcome, MocapError):
            texts += [title, *rows("failed", outcome)]
            summary.append(f"{title}: error: {outcome}")
            to_check.append(title)
            failed.append({"capture": str(job.capture), "name": title, **outcome.as_event()})
            continue
        texts.append(f"{title}\n{outcome.text}")
        warnings = outcome.summary[:-1]
        stated = warnings or tuple(line for line in outcome.summary if line != "OK")
        summary += [f"{title}: {line}" for line in stated]
        to_check += [title] if warnings else []
        takes.append({"capture": str(job.capture), "name": title, **outcome.data})
    first = next((outcome for _, _, outcome in ended if isinstance(outcome, MocapError)), None)
    if first is not None and not takes:
        raise first
    last = f"Look at {', '.join(to_check)}." if to_check else "OK"
    result: TakesResult = {"takes": takes, "failed": failed}
    return Outcome("\n".join(texts), result, (*summary, last))


def _meetings(ended: Sequence[tuple[Job, str, object]]) -> Iterator[tuple[int, list[Motion]]]:
    """Yield the index of each person who came close to other people, and the motions of these people."""
    from solver_backend.fitters.other_skin import only_close
    from solver_backend.io.native.motion_file import read_motion

    takes: dict[str, list[int]] = {}
    for index, (job, _, outcome) in enumerate(ended):
        alone = isinstance(outcome, Outcome) and outcome.data.get("person") and not job.resolve
        if alone and job.settings.contacts and job.settings.method == GLOBAL:
            world = job.capture, {**job.reading(), "person": None}
            takes.setdefault(repr(world), []).append(index)
    for indices in takes.values():
        motions = {index: read_motion(ended[index][0].out) for index in indices}
        for index, one in motions.items():
            others = {
                other.provenance["person"]: near
                for other in motions.values()
                if other.provenance["person"] != one.provenance["person"]
                and other.body == one.body
                and (near := only_close(one, other)) is not None
            }
            if others:
                yield index, list(others.values())


def _parts(job: Job, progress: Progress) -> Iterator[tuple[Job, Capture]]:
    """Yield one job and capture for each person to solve. Several people get separate files."""
    if job.person == EVERYBODY and job.resolve is not None:
        raise CommandLineInvalid("Only one person can be solved again at a time.", hint="--person NAME")
    if job.person != EVERYBODY:
        _check(job)
        yield job, load(job.capture, job.reading(), progress)
        return
    capture = load(job.capture, job.reading(), progress)
    if not capture.people:
        _check(job)
        yield job, capture
    else:
        own = [(person.name, _own_files(job, person.name)) for person in capture.people]
        for _, theirs in own:
            _check(theirs)
        for name, theirs in own:
            yield theirs, capture.of_person(name)


def _own_files(job: Job, person: str) -> Job:
    mark = re.sub(r"\W+", "_", person.casefold()).strip("_")
    report = job.report and job.report.with_name(f"{job.report.stem}_{mark}{job.report.suffix}")
    return replace(job, person=person, out=job.out.with_name(f"{job.out.stem}_{mark}{job.out.suffix}"), report=report)


def _jobs(args: argparse.Namespace) -> list[Job]:
    """Return the jobs from the command line: job files, the trials of a session, or a single job."""
    if args.job is not None:
        given = [
            name for name in VERBS["solve"].given(args) if name not in ("job", "allow_outside", "scheduler", "tls")
        ]
        if given:
            message = f"--job cannot be combined with {', '.join(given)}."
            raise CommandLineInvalid(message, hint="Put it in the job file.")
        return [Job.read(path, allow_outside=args.allow_outside) for path in args.job]
    if args.capture is None or args.out is None:
        raise CommandLineInvalid("solve needs a capture and --out, or --job.", hint="solve CAPTURE --out MOTION.npz")
    options = {item.name: getattr(args, item.name, None) for item in fields(Job)}
    given = {name: tuple(value) if is_list(value) else value for name, value in options.items() if value is not None}
    read = {name: value for name, value in reading(args).items() if name != "sync"}  # which is a setting of the solve
    settings = SolveSettings.from_dict(given_settings(args))
    job: dict[str, Any] = {**given, **read, "settings": settings, "resolve": _resolve(args)}
    each: list[dict[str, Any]] = [{"capture": t, **_files_of_trial(args, t)} for t in trials_of(args.capture)]
    return [Job(**{**job, **own}) for own in each or [{}]]


def _files_of_trial(args: argparse.Namespace, trial: Path) -> dict[str, Any]:
    if args.out.suffix.lower() == MOTION_SUFFIX or args.resolve is not None:
        hint = "To solve all trials, set a folder with --out. To solve one, use solve SESSION/TRIAL --out MOTION.npz."
        raise CommandLineInvalid("The capture is a session with several trials.", where=str(args.capture), hint=hint)
    page = None if args.report is None else args.out / f"{trial.name}.html"
    return {"out": args.out / f"{trial.name}{MOTION_SUFFIX}", "report": page}


def _resolve(args: argparse.Namespace) -> Resolve | None:
    if args.resolve is None:
        return None
    if args.frames is None:
        raise CommandLineInvalid("--resolve needs --frames.", hint="--resolve MOTION.npz --frames FIRST LAST")
    return Resolve(*args.frames, motion=args.resolve)
