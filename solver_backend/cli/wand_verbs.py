"""The verb that calibrates sensors by a waved wand, and lays them on the floor by a Γ."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.outputs import check_output, write_text
from solver_backend.exchange.progress import Progress


def calibrate_wand(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find sensors by a wand, lay them on the floor by a Γ, and write them."""
    from solver_backend.camera_calibration.formats import format_of, write_calibration
    from solver_backend.sensors.take import triggered
    from solver_backend.sensors.wand.evaluation import WandOptions, in_world
    from solver_backend.sensors.wand.gamma import Gamma, gamma_clouds, ground_from_gamma
    from solver_backend.sensors.wand.session import calibrate_by_wand
    from solver_backend.sensors.wand.source import is_sensor_folder, sensor_clouds, wand_views
    from solver_backend.sensors.wand.views import Wand

    overwrite = args.overwrite
    kind = args.format or format_of(args.out)
    if kind != "colmap":
        check_output(args.out, overwrite=overwrite)
    if args.interleave and not args.trigger:
        raise CommandLineInvalid("--interleave needs sensors on one trigger.", hint="Add --trigger.")
    wand = None if args.wand is None else Wand(args.wand[0], args.wand[1])
    long_m, short_m = args.gamma_lengths
    gamma = Gamma(long_m, short_m, args.gamma_height)
    views = wand_views(args.folder, args.lenses, lights=wand is not None, empty=args.empty, progress=progress)
    clocks = triggered(tuple(view.name for view in views), 1e-6 * args.interleave) if args.trigger else None
    found = calibrate_by_wand(views, WandOptions(wand, clocks, args.every_sensor), progress)
    ground = None
    if args.gamma is not None:
        progress("Up, by the Γ", 0, 1)
        cameras = found.array.cameras
        by_sensors = is_sensor_folder(args.gamma)
        clouds = sensor_clouds(args.gamma, cameras, args.empty) if by_sensors else gamma_clouds(args.gamma, cameras)
        ground = ground_from_gamma(clouds, gamma, cameras.centres)
        found = in_world(found, ground)
    write_calibration(args.out, found.array.cameras, kind, found.array.rmse_px, overwrite=overwrite)
    if args.report is not None:
        from solver_backend.sensors.wand.evaluation import wand_page

        write_text(args.report, wand_page(found, ground), overwrite=overwrite)
    return _outcome(found, args.out, kind, args.report)


def _outcome(found: Any, path: Path, kind: str, report: Path | None) -> Outcome:
    lines = [*found.lines(), f"  written     {path} ({kind})"]
    data = {"calibration": str(path), "format": kind, **found.as_dict()}
    if report is not None:
        lines.append(f"  report      {report}")
        data["report"] = str(report)
    return Outcome("\n".join(lines), data)
