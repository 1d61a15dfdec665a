"""Run ``sensors live``: write points, poses or wand coverage, one line per moment."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np

from solver_backend.cli.live_sources import make_ready
from solver_backend.cli.live_verb import LiveOutput, live_text
from solver_backend.cli.outcome import Outcome
from solver_backend.cli.sensor_verbs import chain_of, chain_summary, folder_of, mask_of, oak_devices
from solver_backend.exchange.command import cancelling_until_held
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.events import FrameLine, LiveLine
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.vmc.sender import SENT, read_address
from solver_backend.fitters import solve
from solver_backend.fitters.label_first import labelled_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.live.frames import PointFrame
from solver_backend.live.session import LiveSession, person_fit, with_display
from solver_backend.sensors.chain import LiveMoment, MarkerChain, SensorTask, capture_of
from solver_backend.sensors.devices.recorded import Recording, open_folder
from solver_backend.sensors.wand.views import Coverage

COVERAGE_INTERVAL_S = 0.5  # Seconds between reports of the wand coverage. Chosen by hand.


def sensors_live(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Stream points, poses or wand coverage until the sensors stop, the time is up or a signal arrives."""
    _check(args)
    session = None
    if args.poses:  # this takes time, so do it before the sensors start
        session = LiveSession(*person_fit(args.subject), unit="m", up_axis="z")
        make_ready(session)
    output = LiveOutput(args, None if session is None else session.proportions)
    with cancelling_until_held() as hold, _chain(args) as chain, output:
        until = None if args.seconds is None else chain.start + args.seconds
        moments = _moments(chain, output.lines.write, until, progress)
        lines: Iterator[Any]
        if session is not None:
            poses: Iterator[Any] = session.run(map(_frame, moments))
            shown = (with_display(line, session) if "frame" in line else line for line in poses)
            lines = shown if args.with_points else poses
        elif args.wand:
            lines = _waved(chain, moments)
        else:
            frames = map(_frame, moments)
            plain = ({"t": round(f.time, 6), "points": f.points.round(5).tolist()} for f in frames)
            lines = cast("Iterator[Any]", plain)
        output.run(lines, hold)
    data: dict[str, object] = chain_summary(chain)
    if output.statistics is not None:
        data["poses"] = output.statistics.summary()
    if args.record is not None:
        written = any(end.written for end in chain.ends.values())
        data["recorded" if written else "not_recorded"] = str(args.record)
        if written and args.solve is not None and not output.stopped:
            data["solved"] = _solved(args.record, args.solve, progress, overwrite=args.overwrite)
    data |= output.finish()  # done last, so that the recording can be solved even if lines were lost on a full disk
    # Another program may be reading points from standard output, so nothing else is printed there.
    return Outcome("" if args.lines is None else live_text(args, data), data)


def _check(args: argparse.Namespace) -> None:
    """Reject contradictory options before opening any sensor."""
    if (args.source is None) == (args.oak is None):
        raise CommandLineInvalid("Specify either FOLDER or cameras with --oak ID=NAME.")
    if args.subject is not None and not args.poses:
        raise CommandLineInvalid("--subject needs --poses.")
    if args.send is not None:
        read_address(args.send, SENT)
        if not args.poses:
            raise CommandLineInvalid("--send needs --poses.")
    if args.wand and args.poses:
        raise CommandLineInvalid("--wand and --poses cannot be combined.")
    if args.solve is not None and args.record is None:
        raise CommandLineInvalid("--solve needs --record.")


def _chain(args: argparse.Namespace) -> MarkerChain:
    if args.source is not None:
        return chain_of(args, folder_of(args), args.record, live=True)
    oaks, cameras = oak_devices(args)
    masks, recording = mask_of(args), None
    if args.record is not None:
        recording = Recording(args.record, args.pictures, args.fps, cameras, overwrite=args.overwrite)
    tasks = [
        SensorTask(oak, cameras, masks.get(oak.name), record=args.record, kind=args.pictures) for oak in reversed(oaks)
    ]
    return MarkerChain(tasks, args.fps, args.clusters, recording)


def _moments(
    chain: MarkerChain, write: Callable[[dict[str, object]], None], until: float | None, progress: Progress
) -> Iterator[LiveMoment]:
    """Yield fused markers until the time is up. Write sensor events as soon as they occur."""
    for moment in chain.moments(float("inf") if until is None else until):
        progress("Live", 0, 1)
        if isinstance(moment, LiveMoment):
            yield moment
        else:
            write({"event": moment.kind, "message": moment.message, "diagnostic": moment.found.as_dict()})
        if until is not None and time.perf_counter() > until:
            return


def _frame(moment: LiveMoment) -> PointFrame:
    tracked = moment.tracked
    return PointFrame(tracked.time, tracked.points[tracked.score > 0], moment.arrived)


def _waved(chain: MarkerChain, moments: Iterator[LiveMoment]) -> Iterator[LiveLine]:
    """Yield the wand's image coverage, and where to wave it next, every ``COVERAGE_INTERVAL_S``."""
    cameras = chain.cameras
    coverage, reported, number, moment = Coverage(cameras.names, cameras.image_size), 0.0, 0, None
    for moment in moments:
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
    why = f"More than one light is visible in front of {', '.join(several)}." if several else coverage.next_place()
    why, cloud = why or "The whole volume is covered.", moment.tracked.points.round(4).tolist()
    line: FrameLine = {"frame": number - 1, "t": round(moment.tracked.time, 6), "state": "waving"}
    return {**line, "why": why, "coverage": shares, "cloud": cloud}


def _solved(recording: Path, out: Path, progress: Progress, *, overwrite: bool) -> str:
    capture, _ = labelled_capture(capture_of(open_folder(recording), progress=progress), progress)
    write_motion(out, solve(capture, progress=progress).motion, overwrite=overwrite)
    return str(out)
