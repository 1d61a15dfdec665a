"""The verbs of the marker rig: a cloud from recorded sensors, a recording, and points or poses while it happens."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from solver_backend.cli.live_verb import Lines
from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress

if TYPE_CHECKING:
    from solver_backend.live.frames import PointFrame
    from solver_backend.rig.markers.devices.source import SensorFolder
    from solver_backend.rig.markers.streaming.chain import MarkerChain

SENSOR_VERBS = ("markers-from-sensors", "rig-record", "rig-live")


def add_sensor_verbs(verbs: Any, writing: argparse.ArgumentParser, common: argparse.ArgumentParser) -> None:
    """Add markers-from-sensors, rig-record and rig-live to the parser's verbs."""
    cloud = verbs.add_parser(
        "markers-from-sensors", parents=[writing, common], help="infrared and depth of several sensors to a point cloud"
    )
    cloud.add_argument("--out", type=Path, required=True, metavar="CLOUD.c3d|CLOUD.trc|CAPTURE.npz")
    record = verbs.add_parser("rig-record", parents=[writing, common], help="record sensors to a folder")
    record.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    live = verbs.add_parser(
        "rig-live", parents=[writing, common], help="points, or poses, from sensors while it happens, one line a frame"
    )
    live.add_argument("--poses", action="store_true", help="fit a body to the points: the lines are those of live")
    live.add_argument("--subject", type=Path, metavar="SUBJECT.npz", help="calibrated person, see calibrate")
    live.add_argument("--lines", type=Path, metavar="LINES.jsonl", help="write the lines there, not to standard output")
    live.add_argument("--record", type=Path, metavar="FOLDER", help="also record the sensors' frames")
    live.add_argument("--repeat", action="store_true", help="replay a folder again and again")
    live.add_argument("--seconds", type=float, help="end after so many")
    for verb in (record, live):
        verb.add_argument(
            "--pictures", choices=("raw", "png"), default="raw",
            help="raw is fast and takes 1.5 MB a sensor and frame, png takes two thirds of it and much longer",
        )  # fmt: skip
    for verb in (cloud, record, live):
        verb.add_argument("source", type=Path, metavar="FOLDER", help="a recording, or a shot of the studio")
        verb.add_argument("--calibration", type=Path, metavar="CALIBRATION.toml", help="in the place of the folder's")
        verb.add_argument("--empty", type=Path, metavar="FOLDER", help="a recording of the scene with nobody there")
    for verb in (cloud, live):
        verb.add_argument(
            "--clusters", choices=("test", "radius"), default="test",
            help="join what covariances allow (default), or all within 1 cm as published",
        )  # fmt: skip


def markers_from_sensors(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find markers in the frames of several sensors and write their points as C3D, TRC or our capture."""
    overwrite, suffix = bool(args.overwrite), args.out.suffix.lower()
    if suffix not in (".c3d", ".trc", ".npz"):
        raise CommandLineInvalid("A point cloud is written as .c3d, .trc or .npz.", where=str(args.out))
    check_output(args.out, overwrite=overwrite)
    import numpy as np

    from solver_backend.io.markers.c3d_writer import write_c3d
    from solver_backend.io.markers.trc_writer import write_trc
    from solver_backend.io.native.capture_file import write_capture
    from solver_backend.rig.markers.fusion.settings import FusionSettings
    from solver_backend.rig.markers.take import cloud_of, masks_of
    from solver_backend.types import Capture

    folder = _folder(args)
    masks = {} if args.empty is None else masks_of(_folder(args, args.empty))
    take = cloud_of(folder, masks=masks, fusion=FusionSettings(clusters=args.clusters), progress=progress)
    if suffix == ".npz":
        capture = Capture(
            args.out.stem, cameras=folder.cameras, markers=take.cloud, sources=(str(args.source),),
            problems=take.findings,
        )  # fmt: skip
        write_capture(args.out, capture, overwrite=overwrite)
    else:
        (write_c3d if suffix == ".c3d" else write_trc)(args.out, take.cloud, overwrite=overwrite)
    seen = np.isfinite(take.cloud.positions).all(-1)
    assert take.cloud.residual is not None
    sigma_mm = 1e3 * float(np.nanmedian(take.cloud.residual))
    data = {
        "cloud": str(args.out), "frames": len(seen), "fps": take.cloud.fps,
        "points": round(float(seen.sum(1).mean()), 2),
        "columns": seen.shape[1], "sigma_mm": round(sigma_mm, 3), "sensors": take.frames,
        "findings": list(take.findings),
    }  # fmt: skip
    lines = [
        f"{len(seen)} frames, {seen.sum(1).mean():.1f} points a frame, ± {sigma_mm:.1f} mm in the median",
        *(f"  sensor      {name}: {count} frames" for name, count in take.frames.items()),
        *(f"  finding     {said}" for said in take.findings), f"  written     {args.out}",
    ]  # fmt: skip
    return Outcome("\n".join(lines), data)


def rig_record(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Record all frames of a source."""
    from solver_backend.rig.markers.streaming.chain import LiveMoment

    findings = []
    with _chain(args, args.out, live=False) as chain:
        for moment in chain.moments():
            if isinstance(moment, LiveMoment):
                progress("Recording", 0, 1)
            else:
                findings.append(moment.said)
    data = {"recording": str(args.out), **_summary(chain), "findings": findings}
    lines = [f"{n}: {end.written} frames, {end.dropped} dropped" for n, end in chain.ends.items()]
    lines += [f"finding     {said}" for said in findings]
    return Outcome("\n  ".join([f"recorded {args.out}", *lines]), data)


def rig_live(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Run until the sensors end, or the time is over; the lines are points that ``live -`` reads, or poses."""
    overwrite = bool(args.overwrite)
    if args.lines is not None:
        check_output(args.lines, overwrite=overwrite)
    if args.subject is not None and not args.poses:
        raise CommandLineInvalid("--subject says whose poses are fitted: it goes with --poses.")
    session = statistics = None
    if args.poses:
        from solver_backend.live.recording import person_fit
        from solver_backend.live.session import LiveSession
        from solver_backend.live.statistics import LiveStatistics

        network, fit = person_fit(args.subject)
        session, statistics = LiveSession(network, fit, unit="m", up_axis="z"), LiveStatistics()
    with _chain(args, args.record, live=True) as chain, Lines(args.lines, overwrite) as stream:
        frames = _frames(chain, stream, None if args.seconds is None else chain.start + args.seconds, progress)
        if session is not None and statistics is not None:
            for line in session.run(frames):
                statistics.add(line)
                _say(stream, line)
        else:
            for frame in frames:
                _say(stream, {"t": round(frame.time, 6), "points": frame.points.round(5).tolist()})
    data = _summary(chain) | ({} if statistics is None else {"poses": statistics.summary()})
    if args.record is not None:
        data["recording"] = str(args.record)
    # Standard output may be another program's points: to people it says nothing else.
    text = "" if args.lines is None else f"rig-live: {', '.join(f'{name} {value}' for name, value in data.items())}"
    return Outcome(text, data)


def _frames(chain: MarkerChain, stream: TextIO, until: float | None, progress: Progress) -> Iterator[PointFrame]:
    """Yield the markers of each moment, ghosts left out; what happens to sensors is written at once."""
    from solver_backend.live.frames import PointFrame
    from solver_backend.rig.markers.streaming.chain import LiveMoment

    for moment in chain.moments():
        progress("Live", 0, 1)
        if isinstance(moment, LiveMoment):
            tracked = moment.tracked
            yield PointFrame(tracked.time, tracked.points[tracked.score > 0], moment.arrived)
        else:
            _say(stream, {"event": moment.kind, "message": moment.said})
        if until is not None and time.perf_counter() > until:
            return


def _chain(args: argparse.Namespace, record: Path | None, *, live: bool) -> MarkerChain:
    """Return the chain of a folder: at its recorded rate, or all frames as fast as they are taken."""
    from solver_backend.rig.markers.devices.record import Recording
    from solver_backend.rig.markers.fusion.settings import FusionSettings
    from solver_backend.rig.markers.streaming.chain import MarkerChain
    from solver_backend.rig.markers.streaming.worker import SensorTask
    from solver_backend.rig.markers.take import masks_of

    folder = _folder(args)
    masks = {} if args.empty is None else masks_of(_folder(args, args.empty))
    devices = [replace(device, repeat=live and args.repeat) for device in folder.devices]
    recording = None
    if record is not None:
        recording = Recording(record, args.pictures, folder.fps, folder.cameras, overwrite=bool(args.overwrite))
    tasks = [
        SensorTask(device, folder.cameras, masks.get(device.name), record=record, kind=args.pictures, live=live)
        for device in devices
    ]
    fusion = FusionSettings(clusters=getattr(args, "clusters", "test"))
    return MarkerChain(tasks, folder.fps, fusion, recording)


def _folder(args: argparse.Namespace, path: Path | None = None) -> SensorFolder:
    from solver_backend.rig.markers.devices.source import open_folder

    return open_folder(args.source if path is None else path, args.calibration)


def _summary(chain: MarkerChain) -> dict[str, Any]:
    ends = {
        name: {"frames": end.frames, "cpu_s": round(end.cpu_s, 3), "written": end.written, "dropped": end.dropped}
        for name, end in chain.ends.items()
    }
    return {**chain.statistics.summary(), "sensors": ends, "fusion_cpu_s": round(chain.cpu_s, 3)}


def _say(stream: TextIO, line: dict[str, Any]) -> None:
    stream.write(json.dumps(line) + "\n")
    stream.flush()
