"""The verb that solves: one motion, or those of several people, jobs or trials one after another."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from solver_backend.cli.arguments import given_settings
from solver_backend.cli.motion_and_page import write_both
from solver_backend.cli.outcome import Outcome
from solver_backend.cli.reading import EVERYBODY, load, reading, trials_of
from solver_backend.cli.solve_outcome import outcome_of, record_found
from solver_backend.exchange.cluster_address import use_certificates
from solver_backend.exchange.diagnostics import refuse_errors
from solver_backend.exchange.errors import Cancelled, CommandLineInvalid, MocapError
from solver_backend.exchange.job_file import MOTION_SUFFIX
from solver_backend.exchange.motion_file import is_motion
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.exchange.verb_results import FailedTake, SolveResult, TakeResult, TakesResult
from solver_backend.exchange.verbs import VERBS
from solver_backend.fitters.freed_memory import keep_freed_memory
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.job import Job, Resolve
from solver_backend.types import Capture

if TYPE_CHECKING:
    from solver_backend.fitters.keyframes.optimise import Stretches


def solve(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Solve a capture, write the motion and, if asked for, the report; or do so for several, see ``_several``."""
    jobs = _jobs(args)
    keep_freed_memory()
    if len(jobs) > 1 or jobs[0].person == EVERYBODY:
        with _stretches(args.scheduler, args.tls) as each:
            return _several(jobs, progress, each)
    _check(jobs[0])
    if jobs[0].resolve is not None and is_motion(jobs[0].capture):
        return _resolve_alone(jobs[0], progress)
    with _stretches(args.scheduler, args.tls) as each:
        return _solve_one(jobs[0], load(jobs[0].capture, jobs[0].reading(), progress), progress, each)


@contextmanager
def _stretches(scheduler: str | None, tls: Path | None) -> Iterator[Stretches]:
    """Yield what solves the stretches of a long take: this process, or a cluster."""
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


def _resolve_alone(job: Job, progress: Progress) -> Outcome:
    """Solve frames of a motion again that came without its recording: AMASS, or one of ours from elsewhere."""
    from solver_backend.cli.motion_reading import any_motion
    from solver_backend.fitters.pipeline import resolve_motion
    from solver_backend.io.motions.motion_checks import check_motion
    from solver_backend.io.native.motion_file import write_motion
    from solver_backend.report.checks import by_gravity, recorded_diagnostics

    assert job.resolve is not None
    if job.report is not None:
        raise CommandLineInvalid("A motion without its recording has no report.", where=str(job.report))
    start = time.monotonic()
    measured, earlier = any_motion(job.capture, job.settings.body), any_motion(job.resolve.motion, job.settings.body)
    motion = resolve_motion(measured, earlier, job.resolve.stretch, job.settings, progress).motion
    solve_s = time.monotonic() - start
    found = refuse_errors(
        by_gravity([*recorded_diagnostics(motion), *check_motion(motion)]), job.settings.accept, str(job.capture)
    )
    timed = record_found(job, motion, found, solve_s)
    write_motion(job.out, timed, overwrite=job.overwrite)
    return outcome_of(job, timed, found, solve_s)


def _labels_given(path: Path, capture: Capture) -> dict[tuple[int, int], str]:
    from solver_backend.io.native.user_labels_file import read_user_labels

    if capture.markers is None:
        raise CommandLineInvalid("User-assigned labels are for recordings of markers.", where=str(path))
    return read_user_labels(path, capture.markers)


def _solve_one(job: Job, capture: Capture, progress: Progress, each: Stretches) -> Outcome[SolveResult]:
    from solver_backend.fitters.label_first import labelled_capture, named_points
    from solver_backend.fitters.pipeline import resolve_range
    from solver_backend.fitters.pipeline import solve as solve_capture
    from solver_backend.io.native.motion_file import read_motion, read_subject
    from solver_backend.report.checks import diagnose

    start = time.monotonic()
    if job.labels is not None and job.settings.is_direct:
        raise CommandLineInvalid(
            "User-assigned labels cannot be combined with a network's landmarks.", where=str(job.labels)
        )
    take, own = None, capture.markers
    given = {} if job.labels is None else _labels_given(job.labels, capture)
    if job.labels is not None:
        capture, take = labelled_capture(capture, progress, user_labels=given, always=True)
    elif not (job.settings.layout or job.settings.is_direct):
        capture, take = labelled_capture(capture, progress)
    if job.resolve is None:
        person = None if job.subject is None else read_subject(job.subject)
        if person is not None and take is not None:
            from solver_backend.fitters.label_after import labelled_as_person

            kept = {*given.values(), *(named_points(own).values() if own is not None else ())}
            capture = labelled_as_person(capture, person, job.settings, progress, kept=kept)
        begun = None if job.start is None else read_motion(job.start)
        motion = solve_capture(capture, job.settings, progress, person=person, start=begun, each=each).motion
    else:
        earlier = read_motion(job.resolve.motion)
        if job.person is None and capture.people and earlier.provenance.get("person"):
            capture = capture.of_person(earlier.provenance["person"])
        motion = resolve_range(capture, earlier, job.resolve.stretch, job.settings, progress).motion
    solve_s = time.monotonic() - start
    found = refuse_errors(diagnose(capture, motion), job.settings.accept, str(job.capture))
    timed = record_found(job, motion, found, solve_s)
    write_both(job, capture, timed, progress)
    return outcome_of(job, timed, found, solve_s, capture.person)


@dataclass(frozen=True)
class _Part:
    """One motion of several."""

    job: Job
    capture: Capture

    @property
    def title(self) -> str:
        """What it is of, for people."""
        return f"{self.capture.name}, {self.capture.person}" if self.capture.person else self.capture.name


def _several(jobs: list[Job], progress: Progress, each: Stretches) -> Outcome:
    """Solve jobs one after another, each for everybody where it asks for that; what fails does not stop the others.

    The result holds ``takes``, each as ``solve`` reports it, and ``failed``: capture, person and the error's fields.

    Raises:
        MocapError: nothing could be solved; the first error.
    """
    texts: list[str] = []
    summary: list[str] = []
    to_look_at: list[str] = []
    takes: list[TakeResult] = []
    failed: list[FailedTake] = []
    first: MocapError | None = None
    for number, job in enumerate(jobs):
        parts = _parts(job, progress)
        where = f"{number + 1} of {len(jobs)}: " if len(jobs) > 1 else ""
        while True:
            part = None
            try:
                part = next(parts, None)
                if part is None:
                    break
                prefix = f"{where}{part.title}: "
                outcome = _solve_one(part.job, part.capture, _prefixed(progress, prefix), each)
                texts.append(f"{part.title}\n{outcome.text}")
                warnings = outcome.summary[:-1]
                summary += [f"{part.title}: {line}" for line in warnings]
                to_look_at += [part.title] if warnings else []
                takes.append({"capture": str(job.capture), "name": part.title, **outcome.data})
            except Cancelled:
                raise
            except MocapError as error:
                first = first or error
                title = part.title if part is not None else job.capture.name
                texts.append(f"{title}\n  failed      {error}")
                summary.append(f"{title}: error: {error}")
                to_look_at.append(title)
                failed.append({"capture": str(job.capture), "name": title, **error.as_event()})
    if first is not None and not takes:
        raise first
    last = f"Look at {', '.join(to_look_at)}." if to_look_at else "OK"
    result: TakesResult = {"takes": takes, "failed": failed}
    return Outcome("\n".join(texts), result, (*summary, last))


def _parts(job: Job, progress: Progress) -> Iterator[_Part]:
    """Yield what is solved of a job: the capture's person, or everybody with files of their own."""
    if job.person == EVERYBODY and job.resolve is not None:
        raise CommandLineInvalid("Frames are solved again for one person at a time.", hint="--person NAME")
    if job.person != EVERYBODY:
        _check(job)
        yield _Part(job, load(job.capture, job.reading(), progress))
        return
    capture = load(job.capture, job.reading(), progress)
    if not capture.people:
        _check(job)
        yield _Part(job, capture)
    else:
        own = [(person.name, _own_files(job, person.name)) for person in capture.people]
        for _, theirs in own:
            _check(theirs)
        for name, theirs in own:
            yield _Part(theirs, capture.of_person(name))


def _own_files(job: Job, person: str) -> Job:
    """Return a job for one of several people, whose name follows that of the files."""
    mark = re.sub(r"\W+", "_", person.casefold()).strip("_")
    report = job.report and job.report.with_name(f"{job.report.stem}_{mark}{job.report.suffix}")
    return replace(job, person=person, out=job.out.with_name(f"{job.out.stem}_{mark}{job.out.suffix}"), report=report)


def _prefixed(progress: Progress, prefix: str) -> Progress:
    def prefixed(stage: str, done: int, total: int) -> None:
        progress(prefix + stage, done, total)

    return prefixed


def _jobs(args: argparse.Namespace) -> list[Job]:
    """Return the jobs of the command line: job files, a session's trials, or the options that stand in one job."""
    if args.job is not None:
        given = [name for name in VERBS["solve"].given(args) if name not in ("job", "scheduler", "tls")]
        if given:
            raise CommandLineInvalid(
                f"--job cannot be combined with {', '.join(given)}.", hint="Write it in the job file."
            )
        return [Job.read(path) for path in args.job]
    if args.capture is None or args.out is None:
        raise CommandLineInvalid("solve needs a capture and --out, or --job.", hint="solve CAPTURE --out MOTION.npz")
    read = {name: value for name, value in reading(args).items() if name != "sync"}  # a setting of the solve
    job = {
        "report": args.report, "subject": args.subject, "start": args.start, "labels": args.labels,
        "overwrite": args.overwrite, "strict": args.strict, **read,
        "settings": SolveSettings.from_dict(given_settings(args)), "resolve": _resolve(args),
    }  # fmt: skip
    trials = trials_of(args.capture)
    if not trials:
        return [Job(capture=args.capture, out=args.out, **job)]
    return [Job(capture=trial, **{**job, **_files_of_trial(args, trial)}) for trial in trials]


def _files_of_trial(args: argparse.Namespace, trial: Path) -> dict[str, Path | None]:
    """Return the files of a session's trial, which lie in the folder ``--out``, under the trial's name."""
    if args.out.suffix.lower() == MOTION_SUFFIX or args.resolve is not None:
        raise CommandLineInvalid(
            "The capture is a session of several trials.",
            where=str(args.capture),
            hint="Name a folder with --out for the motions of all, or one trial: solve SESSION/TRIAL --out MOTION.npz.",
        )
    page = None if args.report is None else args.out / f"{trial.name}.html"
    return {"out": args.out / f"{trial.name}{MOTION_SUFFIX}", "report": page}


def _resolve(args: argparse.Namespace) -> Resolve | None:
    if args.resolve is None:
        return None
    if args.frames is None:
        raise CommandLineInvalid("--resolve needs --frames.", hint="--resolve MOTION.npz --frames FIRST LAST")
    return Resolve(args.resolve, FrameRange(*args.frames))
