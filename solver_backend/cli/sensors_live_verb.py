"""The verb that goes from sensors to points, poses or a wand's coverage while it happens, one line a moment."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solver_backend.cli.cancel import cancelling_until_held
from solver_backend.cli.line_output import Lines
from solver_backend.cli.live_sources import make_ready
from solver_backend.cli.live_verb import open_sender, run_lines
from solver_backend.cli.oak_verbs import oak_devices
from solver_backend.cli.outcome import Outcome
from solver_backend.cli.sensor_verbs import chain_of, chain_summary, folder_of, mask_of
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.live_lines import FrameLine, LiveLine
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.vmc.sender import read_address

if TYPE_CHECKING:
    from solver_backend.live.frames import PointFrame
    from solver_backend.live.session import LiveSession
    from solver_backend.sensors.chain import LiveMoment, MarkerChain
    from solver_backend.sensors.wand.views import Coverage

COVERAGE_INTERVAL_S = 0.5
"""Time from one report of the wand's coverage to the next."""


def sensors_live(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Run until the sensors end, the time is over, or whoever started it ends it; what was recorded is kept."""
    overwrite = args.overwrite
    _check(args)
    from solver_backend.live.session_loop import LiveStatistics

    statistics = LiveStatistics()
    session = _session(args.subject) if args.poses else None  # before a sensor begins, for it takes time
    sender = None if session is None else open_sender(args.send, session.proportions)
    with (
        cancelling_until_held() as hold,
        sender or nullcontext(),
        _chain(args) as chain,
        Lines(args.lines) as stream,
    ):
        until = None if args.seconds is None else chain.start + args.seconds
        lines: Iterator[Any]  # without a fit and a wand, the points alone
        if session is not None:
            lines = _poses(session, _frames(chain, stream, until, progress), with_points=args.with_points)
        elif args.wand:
            lines = _waved(chain, stream, until, progress)
        else:
            lines = (
                {"t": round(frame.time, 6), "points": frame.points.round(5).tolist()}
                for frame in _frames(chain, stream, until, progress)
            )
        stopped = run_lines(lines, stream, statistics if session is not None else None, sender, hold)
    data: dict[str, object] = {**chain_summary(chain), "stopped": stopped}
    if session is not None:
        data["poses"] = statistics.summary()
    if sender is not None:
        data |= sender.summary()
    if args.record is not None:
        written = any(end.written for end in chain.ends.values())
        data["recorded" if written else "not_recorded"] = str(args.record)
        if written and args.solve is not None and not stopped:
            data["solved"] = _solved(args.record, args.solve, progress, overwrite=overwrite)
    stream.require_whole()
    # Standard output may be another program's points: for people it holds nothing else.
    text = "" if args.lines is None else f"sensors-live: {', '.join(f'{name} {value}' for name, value in data.items())}"
    return Outcome(text, data)


def _check(args: argparse.Namespace) -> None:
    """Refuse what does not go together, before any sensor is opened.

    Raises:
        CommandLineInvalid: it does not.
    """
    if (args.source is None) == (args.oak is None):
        raise CommandLineInvalid("Give either a FOLDER or cameras, --oak ID=NAME.")
    if args.subject is not None and not args.poses:
        raise CommandLineInvalid("--subject needs --poses: it names their person.")
    if args.send is not None:
        read_address(args.send)
        if not args.poses:
            raise CommandLineInvalid("--send needs --poses.")
    if args.wand and args.poses:
        raise CommandLineInvalid("--wand follows a wand and --poses a person: choose one.")
    if args.solve is not None and args.record is None:
        raise CommandLineInvalid("--solve needs --record.")


def _chain(args: argparse.Namespace) -> MarkerChain:
    """Return the chain of a folder at its recorded rate, or of cameras."""
    if args.source is not None:
        return chain_of(args, folder_of(args), args.record, live=True)
    from solver_backend.sensors.chain import MarkerChain, SensorTask
    from solver_backend.sensors.devices.recorded import Recording
    from solver_backend.sensors.fusion.clusters import FusionSettings

    oaks, cameras = oak_devices(args)
    masks, recording = mask_of(args), None
    if args.record is not None:
        recording = Recording(args.record, args.pictures, args.fps, cameras, overwrite=args.overwrite)
    tasks = [
        SensorTask(oak, cameras, masks.get(oak.name), record=args.record, kind=args.pictures) for oak in reversed(oaks)
    ]
    return MarkerChain(tasks, args.fps, FusionSettings(clusters=args.clusters), recording)


def _moments(chain: MarkerChain, stream: Lines, until: float | None, progress: Progress) -> Iterator[LiveMoment]:
    """Yield moments until the time is over; what happens to sensors is written at once."""
    from solver_backend.sensors.chain import LiveMoment

    for moment in chain.moments():
        progress("Live", 0, 1)
        if isinstance(moment, LiveMoment):
            yield moment
        else:
            stream.write({"event": moment.kind, "message": moment.message, "diagnostic": moment.found.as_dict()})
        if until is not None and time.perf_counter() > until:
            return


def _frames(chain: MarkerChain, stream: Lines, until: float | None, progress: Progress) -> Iterator[PointFrame]:
    """Yield the markers of each moment, ghosts left out."""
    from solver_backend.live.frames import PointFrame

    for moment in _moments(chain, stream, until, progress):
        tracked = moment.tracked
        yield PointFrame(tracked.time, tracked.points[tracked.score > 0], moment.arrived)


def _session(subject: Path | None) -> LiveSession:
    """Return what fits poses, ready to begin."""
    from solver_backend.live.session import LiveSession, person_fit

    network, fit = person_fit(subject)
    session = LiveSession(network, fit, unit="m", up_axis="z")
    make_ready(session)
    return session


def _poses(session: LiveSession, frames: Iterator[PointFrame], *, with_points: bool) -> Iterator[LiveLine]:
    """Yield the lines of the live fit."""
    from solver_backend.live.session_loop import with_display

    for line in session.run(frames):
        yield with_display(line, session) if with_points and "frame" in line else line


def _waved(
    chain: MarkerChain, stream: Lines, until: float | None, progress: Progress
) -> Iterator[LiveLine]:  # fmt: skip
    """Yield a line each ``COVERAGE_INTERVAL_S``: what of every picture the wand visited, and where to go next."""
    import numpy as np

    from solver_backend.sensors.wand.views import Coverage

    cameras = chain.cameras
    coverage, reported, number, moment = Coverage(cameras.names, cameras.image_size), 0.0, 0, None
    for moment in _moments(chain, stream, until, progress):
        px = np.full((len(cameras), 1, 2), np.nan)
        several = [cameras.names[seen.sensor] for seen in moment.seen if len(seen) > 1]
        for seen in moment.seen:
            if len(seen) == 1:
                px[seen.sensor, 0] = seen.px[0]
        coverage.add(px)
        number += 1
        if moment.arrived - reported > COVERAGE_INTERVAL_S:
            reported = moment.arrived
            yield _coverage_line(number, moment, coverage, several)
    if moment is not None:
        yield _coverage_line(number, moment, coverage, [])


def _coverage_line(number: int, moment: LiveMoment, coverage: Coverage, several: list[str]) -> FrameLine:
    shares = dict(zip(coverage.names, coverage.shares.round(3).tolist(), strict=True))
    why = f"More than one point is lit in front of {', '.join(several)}." if several else coverage.next_place()
    return {
        "frame": number - 1, "t": round(moment.tracked.time, 6), "state": "waving",
        "why": why or "The whole volume is covered.",
        "coverage": shares, "cloud": moment.tracked.points.round(4).tolist(),
    }  # fmt: skip


def _solved(recording: Path, out: Path, progress: Progress, *, overwrite: bool) -> str:
    """Solve a recording of sensors and write the motion."""
    from solver_backend.fitters import solve
    from solver_backend.fitters.label_first import labelled_capture
    from solver_backend.io.native.motion_file import write_motion
    from solver_backend.sensors.devices.recorded import open_folder
    from solver_backend.sensors.take import capture_of

    capture, _ = labelled_capture(capture_of(open_folder(recording), progress=progress), progress)
    write_motion(out, solve(capture, progress=progress).motion, overwrite=overwrite)
    return str(out)
