"""The verbs of OAK cameras: which are there, recordings of infrared and depth, and colour video of several in step."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING

from solver_backend.cli.outcome import Outcome, findings_data
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.progress import Progress

if TYPE_CHECKING:
    from solver_backend.sensors.devices.oak import Oak
    from solver_backend.types import Cameras


def oaks(args: argparse.Namespace, progress: Progress) -> Outcome:
    """List the OAKs."""
    from solver_backend.sensors.devices.oak import listed_oaks

    found = listed_oaks()
    return Outcome("\n".join(found) or "No OAK camera was found.", {"oaks": found})


def record_oak(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Record infrared and depth of OAKs; markers are found meanwhile, so that it is seen whether there are any."""
    from solver_backend.sensors.chain import LiveMoment, MarkerChain, SensorTask
    from solver_backend.sensors.devices.recorded import Recording

    oaks, cameras = oak_devices(args)
    recording = Recording(args.folder, "raw", args.fps, cameras, overwrite=args.overwrite)
    # Slaves first, so that they wait when the master begins.
    tasks = [SensorTask(oak, cameras, record=args.folder) for oak in reversed(oaks)]
    findings, points, begin = [], [], 0.0
    with MarkerChain(tasks, args.fps, recording=recording) as chain:
        for moment in chain.moments():
            progress("Recording OAKs", 0, 1)
            if not isinstance(moment, LiveMoment):
                findings.append(moment.found)
                continue
            begin = begin or moment.arrived
            points.append(len(moment.tracked.points))
            if moment.arrived - begin > args.seconds:
                break
    counts = {name: end.written for name, end in chain.ends.items()}
    findings += not_recorded(counts)
    lines = [f"  {name:<11} {end.written} frames, {end.dropped} dropped" for name, end in chain.ends.items()]
    lines += [f"  finding     {sentence(item)}" for item in findings]
    mean = sum(points) / max(len(points), 1)
    text = f"Infrared and depth of {len(oaks)} OAKs in {args.folder}, {mean:.1f} points a frame"
    data = {"recording": str(args.folder), "frames": counts, **findings_data(findings)}
    return Outcome("\n".join([text, *lines]), data)


def not_recorded(counts: Mapping[str, int]) -> list[Diagnostic]:
    """Return a warning of each camera of which no frame was recorded.

    Args:
        counts: frames recorded by camera.
    """
    reason = "no frame of it was recorded"
    return [diagnostic("sensor_failed", cameras=[name], reason=reason) for name, count in counts.items() if not count]


def oak_devices(args: argparse.Namespace) -> tuple[list[Oak], Cameras]:
    """Return the closed cameras of a command line, the one that gives the pulse first, and their calibration.

    Raises:
        BackendMissing: depthai is not installed.
        CommandLineInvalid, SensorUnknown: see ``_named``.
        SensorFailed, CalibrationMissing: see ``oak_cameras``.
    """
    from solver_backend.io.calibration.read import read_calibration
    from solver_backend.sensors.devices import oak
    from solver_backend.sensors.devices.oak import Oak, OakSettings, oak_cameras

    given = _named(args)
    oak.depthai()  # reported now, not by each camera's process again and again
    roles = {"wire": ("master", "slave")}.get(args.sync, (args.sync, args.sync))
    oaks = [
        Oak(name, identifier, OakSettings(args.fps, exposure_us=args.exposure, flood=args.flood, sync=roles[c > 0]))
        for c, (name, identifier) in enumerate(given.items())
    ]
    return oaks, oak_cameras(oaks) if args.calibration is None else read_calibration(args.calibration).cameras


def _named(args: argparse.Namespace) -> dict[str, str]:
    """Return the identifiers of the cameras by their names.

    Raises:
        CommandLineInvalid: names repeat.
        SensorUnknown: a camera is of another kind, or has no identifier.
    """
    from solver_backend.sensors.devices.oak import device_named

    given = [device_named(text if ":" in text else f"oak:{text}") for text in args.oak]
    found = {oak.name: oak.identifier for oak in given}
    if len(found) < len(given):
        raise CommandLineInvalid("Two cameras have the same name.", hint="Give --oak ID=NAME.")
    return found


def record_colour(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Record colour video of OAKs."""
    from solver_backend.sensors.devices.oak_colour import OakColour
    from solver_backend.sensors.devices.oak_colour import record_colour as record

    role = ("master", "slave") if args.wire else ("none", "none")
    cameras = {
        name: OakColour(name, identifier, fps=args.fps, role=role[c > 0])
        for c, (name, identifier) in enumerate(_named(args).items())
    }
    progress("Colour of OAKs", 0, 1)
    with ExitStack() as stack:
        # Slaves first, so that they wait when the master begins.
        for camera in reversed(list(cameras.values())):
            stack.enter_context(camera)
        size = next(iter(cameras.values())).size
        counts = record(cameras, args.folder, size, args.fps, args.seconds)
    lines = [f"  {name:<11} {count} pictures" for name, count in counts.items()]
    return Outcome("\n".join([f"Colour of {len(counts)} cameras in {args.folder}", *lines]), {"pictures": counts})
