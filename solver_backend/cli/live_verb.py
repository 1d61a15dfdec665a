"""The verb that runs live: points from a replayed file or from lines, poses as lines."""

from __future__ import annotations

import argparse
import gc
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solver_backend.cli.line_output import Lines
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import Cancelled, CommandLineInvalid
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress

if TYPE_CHECKING:
    from solver_backend.live.frames import PointFrame
    from solver_backend.live.session import LiveSession
    from solver_backend.live.statistics import LiveStatistics


def add_live(
    verbs: Any, reading: argparse.ArgumentParser, writing: argparse.ArgumentParser, common: argparse.ArgumentParser
) -> None:
    """Add live to the parser's verbs."""
    live = verbs.add_parser(
        "live", parents=[reading, writing, common], help="stream poses from marker points, one line a frame"
    )
    live.add_argument("source", metavar="SOURCE", help="take to replay at its own rate, or - for lines on stdin")
    live.add_argument("--fast", action="store_true", help="replay as fast as it goes")
    live.add_argument("--lines", type=Path, metavar="POSES.jsonl", help="write the lines there, not to standard output")
    live.add_argument("--record", type=Path, metavar="TAKE.c3d", help="also record the points, to be solved afterwards")
    live.add_argument("--subject", type=Path, metavar="SUBJECT.npz", help="calibrated person, see calibrate")
    live.add_argument("--with-points", action="store_true", help="each line also holds the points, for a display")


def live(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Run until the source ends; nothing that comes in ends it."""
    overwrite = bool(args.overwrite)
    for path in (args.lines, args.record):
        if path is not None:
            check_output(path, overwrite=overwrite)
    if args.parent_pipe and args.source == "-":
        raise CommandLineInvalid("--parent-pipe watches standard input, which the points come by.")
    from solver_backend.live.frames import from_lines, replayed
    from solver_backend.live.person import person_fit
    from solver_backend.live.recording import LiveRecorder
    from solver_backend.live.session import LiveSession
    from solver_backend.live.statistics import LiveStatistics

    network, fit = person_fit(args.subject)
    if args.source == "-":
        session = LiveSession(network, fit, unit=args.unit, up_axis=args.up_axis)
        frames = from_lines(sys.stdin.buffer, args.fps or 120.0)
        fps = args.fps
    else:
        cloud = _cloud(args, progress)
        session = LiveSession(network, fit, unit="m", up_axis="z")
        frames, fps = replayed(cloud, paced=not args.fast), cloud.fps
    statistics = LiveStatistics()
    recorder = None
    if args.record is not None:
        recorder = LiveRecorder(args.record, fps, lambda: session.to_metres, overwrite=overwrite)
    make_ready(session)
    with recorder or nullcontext(), Lines(args.lines) as stream:
        if recorder is not None and recorder.recovered is not None:
            stream.write(_event("recovered", f"A recording that was not finished is now {recorder.recovered}."))
        stopped = _run(session, frames if recorder is None else recorder.watched(frames), stream, args, statistics)
    data: dict[str, Any] = {**statistics.summary(), "stopped": stopped}
    if recorder is not None:
        if recorder.recovered is not None:
            data["recovered"] = str(recorder.recovered)
        if recorder.count and args.record is not None and args.record.exists():
            data["recorded"] = str(args.record)
    stream.require_whole()
    text = ", ".join(f"{name} {value}" for name, value in data.items())
    return Outcome(f"live: {text}", data)


def _run(
    session: LiveSession, frames: Iterator[PointFrame], stream: Lines, args: argparse.Namespace,
    statistics: LiveStatistics,
) -> bool:  # fmt: skip
    """Write a line a frame until the source ends; return whether somebody stopped it before."""
    try:
        for line in session.run(frames):
            statistics.add(line)
            if args.with_points and session.shown is not None and "frame" in line:
                line = {**line, "cloud": session.shown.round(4).tolist()}
            stream.write(line)
    except Cancelled:  # the usual end of what is live: what was recorded is kept
        stream.end_line()
        return True
    return False


def _event(kind: str, message: str) -> dict[str, Any]:
    return {"event": kind, "t": None, "message": message}


def make_ready(session: LiveSession) -> None:
    """Let no frame be late by what can be done before the first."""
    session.warm_up()
    # What is there by now stays; walking through it again and again would make frames late.
    gc.collect()
    gc.freeze()


def _cloud(args: argparse.Namespace, progress: Progress) -> Any:
    from solver_backend.cli.reading import loaded
    from solver_backend.exchange.errors import NoDetections

    args.capture = Path(args.source)
    capture = loaded(args, progress)
    if capture.markers is None:
        raise NoDetections("The capture has no markers to replay.", where=capture.name, hint="Choose a C3D or TRC.")
    return capture.markers
