"""The verbs of sensor arrays' recordings: a cloud from recorded sensors, and a recording of them."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solver_backend.cli.outcome import Outcome, findings_data
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.progress import Progress

if TYPE_CHECKING:
    from solver_backend.sensors.chain import MarkerChain
    from solver_backend.sensors.devices.recorded import SensorFolder


def markers_from_sensors(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find markers in the frames of several sensors and write their points in a format of markers or as our capture."""
    overwrite, suffix = args.overwrite, args.out.suffix.lower()
    import numpy as np

    from solver_backend.io.markers.read import write_markers
    from solver_backend.io.native.capture_file import write_capture
    from solver_backend.sensors.fusion.clusters import FusionSettings
    from solver_backend.sensors.take import capture_from, cloud_of

    folder = folder_of(args)
    take = cloud_of(folder, masks=mask_of(args), fusion=FusionSettings(clusters=args.clusters), progress=progress)
    if suffix == ".npz":
        write_capture(args.out, capture_from(folder, take, args.out.stem), overwrite=overwrite)
    else:
        write_markers(args.out, take.cloud, overwrite=overwrite)
    seen = np.isfinite(take.cloud.positions).all(-1)
    assert take.cloud.residual is not None
    sigma_mm = 1e3 * float(np.nanmedian(take.cloud.residual))
    data = {
        "cloud": str(args.out), "frames": len(seen), "fps": take.cloud.fps,
        "points": round(float(seen.sum(1).mean()), 2),
        "columns": seen.shape[1], "sigma_mm": round(sigma_mm, 3), "sensors": take.frames,
        **findings_data(take.findings),
    }  # fmt: skip
    lines = [
        f"{len(seen)} frames, {seen.sum(1).mean():.1f} points a frame, ± {sigma_mm:.1f} mm in the median",
        *(f"  sensor      {name}: {count} frames" for name, count in take.frames.items()),
        *(f"  finding     {sentence(item)}" for item in take.findings), f"  written     {args.out}",
    ]  # fmt: skip
    return Outcome("\n".join(lines), data)


def sensors_record(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Record all frames of a source."""
    from solver_backend.sensors.chain import LiveMoment

    findings = []
    with chain_of(args, folder_of(args), args.out, live=False) as chain:
        for moment in chain.moments():
            if isinstance(moment, LiveMoment):
                progress("Recording", 0, 1)
            else:
                findings.append(moment.found)
    data = {"recording": str(args.out), **chain_summary(chain), **findings_data(findings)}
    lines = [f"{n}: {end.written} frames, {end.dropped} dropped" for n, end in chain.ends.items()]
    lines += [f"finding     {sentence(item)}" for item in findings]
    return Outcome("\n  ".join([f"recorded {args.out}", *lines]), data)


def chain_of(args: argparse.Namespace, folder: SensorFolder, record: Path | None, *, live: bool) -> MarkerChain:
    """Return the chain of a folder: at its recorded rate, or all frames as fast as they are taken."""
    from solver_backend.sensors.chain import MarkerChain, SensorTask
    from solver_backend.sensors.devices.recorded import Recording
    from solver_backend.sensors.fusion.clusters import FusionSettings

    masks = mask_of(args)
    devices = [replace(device, repeat=live and args.repeat) for device in folder.devices]
    recording = None
    if record is not None:
        recording = Recording(record, args.pictures, folder.fps, folder.cameras, overwrite=args.overwrite)
    tasks = [
        SensorTask(device, folder.cameras, masks.get(device.name), record=record, kind=args.pictures, live=live)
        for device in devices
    ]
    return MarkerChain(tasks, folder.fps, FusionSettings(clusters=args.clusters), recording)


def folder_of(args: argparse.Namespace, path: Path | None = None) -> SensorFolder:
    """Return the folder of sensors of a command line, opened."""
    from solver_backend.sensors.devices.recorded import open_folder

    return open_folder(args.source if path is None else path, args.calibration)


def mask_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return each sensor's mask of what is bright with nobody there, where a recording of that is given."""
    from solver_backend.sensors.take import masks_of

    return {} if args.empty is None else masks_of(folder_of(args, args.empty))


def chain_summary(chain: MarkerChain) -> dict[str, object]:
    """Return plain values about a chain that has ended."""
    ends = {
        name: {"frames": end.frames, "cpu_s": round(end.cpu_s, 3), "written": end.written, "dropped": end.dropped}
        for name, end in chain.ends.items()
    }
    return {**chain.statistics.summary(), "sensors": ends, "fusion_cpu_s": round(chain.cpu_s, 3)}
