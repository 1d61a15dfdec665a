"""Run the camera verbs: print boards, and compute and check calibrations."""

from __future__ import annotations

import argparse
from typing import Any

from solver_backend.cli.outcome import Outcome, found_data, rows, sentences
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.outputs import atomic_output, check_output, write_text
from solver_backend.exchange.progress import Progress


def board(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a calibration board for printing, and a .toml file that describes it."""
    from solver_backend.camera_calibration.boards.board import board_named
    from solver_backend.camera_calibration.boards.page import board_page, pdf, svg
    from solver_backend.camera_calibration.formats import board_toml

    described = args.out.with_suffix(".toml")
    check_output(described, overwrite=args.overwrite)
    chosen = board_named(args.board)
    page = board_page(chosen, args.paper)
    if args.out.suffix.lower() == ".svg":
        write_text(args.out, svg(page), overwrite=args.overwrite)
    else:
        with atomic_output(args.out, overwrite=args.overwrite) as temporary:
            temporary.write_bytes(pdf(page))
    write_text(described, board_toml(chosen), overwrite=args.overwrite)
    width, height = page.size
    progress("Board", 1, 1)
    size = f"{width:.0f} x {height:.0f} mm. Print at 100 % and measure the line of 100 mm"
    lines = [str(chosen), *rows("page", size), *rows("written", args.out), *rows("board", described)]
    data = {"board": str(args.out), "description": str(described), "page_mm": [width, height]}
    return Outcome("\n".join(lines), data)


def calibrate_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Calibrate cameras from a board, a person or clicked points, and write the calibration."""
    import numpy as np

    from solver_backend.camera_calibration.formats import write_calibration
    from solver_backend.cli.camera_sources import calibrated

    if args.method == "lenses":
        return _lenses(args, progress)
    kind = _format_of_output(args)
    found = calibrated(args, progress)
    cameras = found.cameras
    write_calibration(args.out, cameras, kind, found.rmse_px, overwrite=args.overwrite)
    if args.keep_lenses is not None:
        from solver_backend.camera_calibration.adjustment.lens import lens_of
        from solver_backend.camera_calibration.intrinsics.known_lenses import keep_lenses

        errors = {n: e for n, lens in found.lenses.items() if isinstance(e := lens.get("held_out_px"), float)}
        keep_lenses(args.keep_lenses, {n: lens_of(cameras, c) for c, n in enumerate(cameras.names)}, errors)
    lines, data = [f"{len(cameras)} cameras by {found.method}, {found.rmse_px:.2f} px"], []
    for c, name in enumerate(cameras.names):
        rmse_px, centre, lens = float(found.camera_rmse_px[c]), cameras.centres[c].tolist(), found.lenses.get(name, {})
        sigma_mm, sigma_deg = 1000 * float(found.centre_sigma_m[c]), float(np.degrees(found.turn_sigma[c]))
        model = f", {lens['model']} {lens['held_out_px']:.2f} px" if lens else ""
        place = ", ".join(f"{value:.3f}" for value in centre)
        lines.append(
            f"  {name:<11} {rmse_px:.2f} px, at ({place}) m ± {sigma_mm:.1f} mm, ± {sigma_deg:.2f}°, "
            f"f {cameras.K[c, 0, 0]:.1f} px{model}"
        )
        pose = {"centre_m": centre, "centre_sigma_mm": sigma_mm, "turn_sigma_deg": sigma_deg}
        data.append({"name": name, "rmse_px": rmse_px, **pose, "delay_s": float(found.delays_s[c]), **lens})
    lines += [*rows("note", *found.notes), *rows("finding", *found.findings), *rows("written", f"{args.out} ({kind})")]
    result = {"calibration": str(args.out), "format": kind, "method": found.method, "rmse_px": found.rmse_px}
    words = {"findings": sentences(found.findings), "notes": sentences(found.notes)}
    return Outcome("\n".join(lines), {**result, "cameras": data, **words})


def _format_of_output(args: argparse.Namespace) -> str:
    """Return the calibration format to write, and check that the file can be written."""
    from solver_backend.camera_calibration.formats import format_of

    kind = args.format or format_of(args.out)
    if kind != "colmap":  # the output in COLMAP's format is a folder
        check_output(args.out, overwrite=args.overwrite)
    return kind


def _lenses(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Estimate only the lens parameters, and add them to a lens library."""
    from solver_backend.camera_calibration.intrinsics.known_lenses import keep_lenses
    from solver_backend.cli.camera_sources import calibrated_lenses

    if args.out.suffix.lower() != ".json":
        raise CommandLineInvalid("The name of a lens library must end in .json.", where=str(args.out))
    found = calibrated_lenses(args, progress)
    keep_lenses(args.out, {n: e.lens for n, e in found.items()}, {n: e.held_out for n, e in found.items()})
    lines, data = [f"{len(found)} lenses"], {}
    for name, lens in found.items():
        fit, held_out = lens.fit, lens.held_out
        lines.append(
            f"  {name:<11} {fit.model.name}, {held_out:.2f} px held out, f {lens.lens.K[0, 0]:.1f} px "
            f"± {fit.focal_sigma_px:.1f}, {len(lens.frames)} images, worst {fit.view_rmse_px.max():.2f} px, "
            f"left out {len(lens.left_out)}"
        )
        lines += rows("finding", *lens.advice)
        used = {"pictures": list(lens.frames), "view_rmse_px": fit.view_rmse_px.tolist()}
        used |= {"left_out": list(lens.left_out), "findings": sentences(lens.advice)}
        data[name] = {"model": fit.model.name, "held_out_px": held_out, **used}
    return Outcome("\n".join([*lines, *rows("written", args.out)]), {"lenses": str(args.out), "cameras": data})


def check_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Check whether a capture's calibration fits its keypoints."""
    from solver_backend.camera_calibration.calibration_check import check_calibration
    from solver_backend.cli.camera_sources import capture_of

    capture = capture_of(args, progress)
    cameras, keypoints = capture.require_multiview()
    found = check_calibration(cameras, keypoints, progress)
    per_camera = zip(cameras.names, found.camera_px, found.worst_regions, strict=True)
    lines = [
        f"{args.capture}: {found.verdict}",
        *(f"  {name:<11} {rms:5.1f} px, worst part {part} {worst:.1f} px" for name, rms, (part, worst) in per_camera),
        *rows("finding", *found.diagnostics),
        *rows("problem", *capture.problems),
    ]
    data = found.as_dict()
    data["problems"] = sentences(capture.problems)
    data["capture_diagnostics"] = [item.as_dict() for item in capture.problems]
    return Outcome("\n".join(lines), data)


def fit_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Correct, scale and level the cameras of a capture, and write the calibration."""
    from solver_backend.camera_calibration.formats import write_calibration
    from solver_backend.cli.camera_sources import capture_of
    from solver_backend.io.recognition.world_fit import check_world

    kind = _format_of_output(args)
    capture = capture_of(args, progress)
    cameras, keypoints = capture.require_multiview()
    world = check_world(cameras, keypoints)
    write_calibration(args.out, cameras, kind, world.residual_px, overwrite=args.overwrite)
    lines = [
        f"{len(cameras)} cameras of {capture.name}, views agree to within {world.residual_px:.1f} px",
        *rows("note", *capture.notes),
        *rows("problem", *capture.problems),
        *rows("written", f"{args.out} ({kind})"),
    ]
    data = {"calibration": str(args.out), "format": kind, "cameras": list(cameras.names)}
    data |= {"residual_px": world.residual_px, "stature_m": world.stature_m}
    return Outcome("\n".join(lines), {**data, **found_data((*capture.problems, *capture.notes))})


def calibrate_wand(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Calibrate sensors from a waved wand. Optionally, align the axes with a Γ of markers on the floor."""
    from solver_backend.camera_calibration.formats import write_calibration
    from solver_backend.sensors.chain import triggered
    from solver_backend.sensors.wand.evaluation import WandOptions, in_world
    from solver_backend.sensors.wand.gamma import Gamma, gamma_clouds, ground_from_gamma
    from solver_backend.sensors.wand.session import calibrate_by_wand
    from solver_backend.sensors.wand.views import Wand, is_sensor_folder, sensor_clouds, wand_views

    kind = _format_of_output(args)
    if args.interleave and not args.trigger:
        raise CommandLineInvalid("--interleave is only possible with --trigger.", hint="Add --trigger.")
    wand = None if args.wand is None else Wand(args.wand[0], args.wand[1])
    long_m, short_m = args.gamma_lengths
    gamma = Gamma(long_m, short_m, args.gamma_height)
    views = wand_views(args.folder, args.lenses, lights=wand is not None, empty=args.empty, progress=progress)
    clocks = triggered(tuple(view.name for view in views), 1e-6 * args.interleave) if args.trigger else None
    found: Any = calibrate_by_wand(views, WandOptions(wand, clocks, args.every_sensor), progress)
    ground = None
    if args.gamma is not None:
        progress("Up, by the Γ", 0, 1)
        cameras = found.array.cameras
        by_sensors = is_sensor_folder(args.gamma)
        clouds = sensor_clouds(args.gamma, cameras, args.empty) if by_sensors else gamma_clouds(args.gamma, cameras)
        ground = ground_from_gamma(clouds, gamma, cameras.centres)
        found = in_world(found, ground)
    write_calibration(args.out, found.array.cameras, kind, found.array.rmse_px, overwrite=args.overwrite)
    lines = [*found.lines(), *rows("written", f"{args.out} ({kind})")]
    data = {"calibration": str(args.out), "format": kind, **found.as_dict()}
    if args.report is not None:
        from solver_backend.sensors.wand.evaluation import wand_page

        write_text(args.report, wand_page(found, ground), overwrite=args.overwrite)
        lines += rows("report", args.report)
        data["report"] = str(args.report)
    return Outcome("\n".join(lines), data)
