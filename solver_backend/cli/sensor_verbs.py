"""Run the verbs for recorded sensors and OAK cameras."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.cli.outcome import Outcome, findings_data, rows
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.markers.read import write_markers
from solver_backend.io.native.capture_file import write_capture
from solver_backend.sensors.chain import LiveMoment, MarkerChain, SensorTask, capture_of, cloud_of, masks_of
from solver_backend.sensors.devices import oak
from solver_backend.sensors.devices.oak import Oak, OakColour, OakSettings, device_named, listed_oaks, oak_cameras
from solver_backend.sensors.devices.oak import record_colour as record
from solver_backend.sensors.devices.recorded import Recording, SensorFolder, open_folder
from solver_backend.types import Cameras


def markers_from_sensors(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find markers in a sensor recording, and write markers or a capture."""
    folder = folder_of(args)
    take = cloud_of(folder, masks=mask_of(args), clusters=args.clusters, progress=progress)
    if args.out.suffix.lower() == ".npz":
        write_capture(args.out, capture_of(folder, take, args.out.stem), overwrite=args.overwrite)
    else:
        write_markers(args.out, take.cloud, overwrite=args.overwrite)
    seen = np.isfinite(take.cloud.positions).all(-1)
    assert take.cloud.residual is not None
    points, sigma_mm = float(seen.sum(1).mean()), 1e3 * float(np.nanmedian(take.cloud.residual))
    data = {"frames": len(seen), "fps": take.cloud.fps, "columns": seen.shape[1]}
    data |= {"points": round(points, 2), "sigma_mm": round(sigma_mm, 3), "sensors": take.frames}
    lines = [
        f"{len(seen)} frames, {points:.1f} points per frame, ± {sigma_mm:.1f} mm (median)",
        *rows("sensor", *(f"{name}: {count} frames" for name, count in take.frames.items())),
        *rows("finding", *take.findings),
    ]
    return Outcome("\n".join(lines), {**data, **findings_data(take.findings)})


def sensors_record(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Copy every frame of a sensor recording to another folder."""
    findings = []
    with chain_of(args, folder_of(args), args.out, live=False) as chain:
        for moment in chain.moments():
            if isinstance(moment, LiveMoment):
                progress("Recording", 0, 1)
            else:
                findings.append(moment.found)
    data = {"recording": str(args.out), **chain_summary(chain), **findings_data(findings)}
    lines = [f"  {n}: {end.written} frames, {end.dropped} dropped" for n, end in chain.ends.items()]
    return Outcome("\n".join([f"recorded {args.out}", *lines, *rows("finding", *findings)]), data)


def chain_of(args: argparse.Namespace, folder: SensorFolder, record: Path | None, *, live: bool) -> MarkerChain:
    """Create a chain that finds markers in a folder of sensor recordings.

    Args:
        record: folder to copy the images to, if any.
        live: True plays the recordings at their frame rate. False reads all frames at full speed.
    """
    masks, recording = mask_of(args), None
    devices = [replace(device, repeat=live and args.repeat) for device in folder.devices]
    if record is not None:
        recording = Recording(record, args.pictures, folder.fps, folder.cameras, overwrite=args.overwrite)
    tasks = [
        SensorTask(device, folder.cameras, masks.get(device.name), record=record, kind=args.pictures, live=live)
        for device in devices
    ]
    return MarkerChain(tasks, folder.fps, args.clusters, recording)


def folder_of(args: argparse.Namespace, path: Path | None = None) -> SensorFolder:
    """Open the sensor recording at ``path``, or the recording on the command line if ``path`` is None."""
    return open_folder(args.source if path is None else path, args.calibration)


def mask_of(args: argparse.Namespace) -> dict[str, Any]:
    """Find each sensor's bright areas in a recording of the empty scene. Return {} without a recording."""
    return {} if args.empty is None else masks_of(folder_of(args, args.empty))


def chain_summary(chain: MarkerChain) -> dict[str, object]:
    """Return the statistics of a finished marker chain as JSON values."""
    ends = {
        name: {"frames": end.frames, "cpu_s": round(end.cpu_s, 3), "written": end.written, "dropped": end.dropped}
        for name, end in chain.ends.items()
    }
    return {**chain.statistics.summary(), "sensors": ends, "fusion_cpu_s": round(chain.cpu_s, 3)}


def oaks(args: argparse.Namespace, progress: Progress) -> Outcome:
    """List the OAK devices on USB and the network."""
    found = listed_oaks()
    return Outcome("\n".join(found) or "No OAK camera was found.", {"oaks": found})


def record_oak(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Record infrared and depth images from OAK cameras, and count the visible markers."""
    oaks, cameras = oak_devices(args)
    recording = Recording(args.folder, "raw", args.fps, cameras, overwrite=args.overwrite)
    # Start slaves first, so that they are waiting when the master starts.
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
    mean = sum(points) / max(len(points), 1)
    lines = [
        f"Infrared and depth of {len(oaks)} OAKs in {args.folder}, {mean:.1f} points per frame",
        *(f"  {name:<11} {end.written} frames, {end.dropped} dropped" for name, end in chain.ends.items()),
        *rows("finding", *findings),
    ]
    data = {"recording": str(args.folder), "frames": counts, **findings_data(findings)}
    return Outcome("\n".join(lines), data)


def not_recorded(counts: Mapping[str, int]) -> list[Diagnostic]:
    """Return a warning for each camera without recorded frames."""
    reason = "no frame of it was recorded"
    return [diagnostic("sensor_failed", cameras=[name], reason=reason) for name, count in counts.items() if not count]


def oak_devices(args: argparse.Namespace) -> tuple[list[Oak], Cameras]:
    """Return the OAK cameras from the command line, and their calibration.

    With wired synchronisation, the first camera sends the pulses. The cameras are not opened.
    """
    given = _named(args)
    oak.depthai()  # fail here once, not in each camera's process
    roles = {"wire": ("master", "slave")}.get(args.sync, (args.sync, args.sync))
    oaks = [
        Oak(name, identifier, OakSettings(args.fps, exposure_us=args.exposure, flood=args.flood, sync=roles[c > 0]))
        for c, (name, identifier) in enumerate(given.items())
    ]
    return oaks, oak_cameras(oaks) if args.calibration is None else read_calibration(args.calibration).cameras


def _named(args: argparse.Namespace) -> dict[str, str]:
    """Return the device identifier of each OAK camera by name.

    Raises:
        SensorUnknown: a camera is of another type, or its identifier is missing.
    """
    given = [device_named(text if ":" in text else f"oak:{text}") for text in args.oak]
    found = {oak.name: oak.identifier for oak in given}
    if len(found) < len(given):
        raise CommandLineInvalid("Two cameras have the same name.", hint="Specify --oak ID=NAME.")
    return found


def record_colour(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Record synchronised colour video from OAK cameras."""
    roles = ("master", "slave") if args.wire else ("none", "none")
    cameras = {
        name: OakColour(name, identifier, fps=args.fps, role=roles[c > 0])
        for c, (name, identifier) in enumerate(_named(args).items())
    }
    progress("Colour of OAKs", 0, 1)
    with ExitStack() as stack:
        # Start slaves first, so that they are waiting when the master starts.
        for camera in reversed(list(cameras.values())):
            stack.enter_context(camera)
        size = next(iter(cameras.values())).size
        counts = record(cameras, args.folder, size, args.fps, args.seconds)
    lines = [f"  {name:<11} {count} pictures" for name, count in counts.items()]
    return Outcome("\n".join([f"Colour of {len(counts)} cameras in {args.folder}", *lines]), {"pictures": counts})
