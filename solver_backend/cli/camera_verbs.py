"""The verbs of cameras: a board to print, the calibration of an array, and whether one fits."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from solver_backend.cli.outcome import Outcome
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.exchange.outputs import check_output
from solver_backend.exchange.progress import Progress

METHODS = ("board", "person", "points", "refine", "together", "lenses")
_BOARD = "KIND:COLUMNSxROWS:SQUARE, such as charuco:5x7:35mm, or a board.toml"
_SOURCE = "footage of a board, capture, table of clicked points or calibration, as --from needs it"


def board(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a board to print, and beside it the file that describes it."""
    from solver_backend.camera_calibration.boards.board import board_named, board_toml
    from solver_backend.camera_calibration.boards.page import board_page, pdf, svg
    from solver_backend.exchange.outputs import write_text

    suffix, overwrite = args.out.suffix.lower(), args.overwrite
    described = args.out.with_suffix(".toml")
    check_output(described, overwrite=overwrite)
    chosen = board_named(args.board)
    page = board_page(chosen, args.paper)
    if suffix == ".svg":
        write_text(args.out, svg(page), overwrite=overwrite)
    else:
        _write_bytes(args.out, pdf(page), overwrite)
    write_text(described, board_toml(chosen), overwrite=overwrite)
    width, height = page.size
    progress("Board", 1, 1)
    text = (
        f"{chosen}\n  page        {width:.0f} x {height:.0f} mm; print at 100 % and measure the line of 100 mm"
        f"\n  written     {args.out}\n  board       {described}"
    )
    return Outcome(text, {"board": str(args.out), "description": str(described), "page_mm": [width, height]})


def calibrate_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find cameras by a board, a person or clicked points, or refine them, and write them."""
    from solver_backend.camera_calibration.formats import format_of, write_calibration
    from solver_backend.camera_calibration.intrinsics.known_lenses import keep_lenses
    from solver_backend.cli.camera_sources import calibrated

    if args.method == "lenses":
        return _lenses(args, progress)
    overwrite = args.overwrite
    kind = args.format or format_of(args.out)
    if kind != "colmap":
        check_output(args.out, overwrite=overwrite)
    found = calibrated(args, progress)
    write_calibration(args.out, found.cameras, kind, found.rmse_px, overwrite=overwrite)
    if args.keep_lenses is not None:
        from solver_backend.camera_calibration.adjustment.lens import lens_of

        names = found.cameras.names
        errors = {n: e for n, lens in found.lenses.items() if isinstance(e := lens.get("held_out_px"), float)}
        keep_lenses(args.keep_lenses, {n: lens_of(found.cameras, c) for c, n in enumerate(names)}, errors)
    return _outcome(found, args.out, kind)


def _lenses(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Find the lenses alone and add them to a library."""
    from solver_backend.camera_calibration.intrinsics.known_lenses import keep_lenses
    from solver_backend.cli.camera_sources import calibrated_lenses

    if args.out.suffix.lower() != ".json":
        raise CommandLineInvalid("Lenses are kept in a library that ends in .json.", where=str(args.out))
    found = calibrated_lenses(args, progress)
    keep_lenses(args.out, {n: e.lens for n, e in found.items()}, {n: e.choice.held_out for n, e in found.items()})
    lines, data = [f"{len(found)} lenses"], {}
    for name, lens in found.items():
        fit, worst = lens.choice.fit, float(lens.choice.fit.view_rmse_px.max())
        lines.append(
            f"  {name:<11} {fit.model.name}, {lens.choice.held_out:.2f} px held out, f {lens.lens.K[0, 0]:.1f} px "
            f"± {fit.focal_sigma_px:.1f}, {len(lens.frames)} pictures, worst {worst:.2f} px, "
            f"left out {len(lens.left_out)}"
        )
        advice = [sentence(item) for item in lens.advice]
        lines += [f"  finding     {item}" for item in advice]
        data[name] = {"model": fit.model.name, "held_out_px": lens.choice.held_out, "pictures": list(lens.frames),
                      "view_rmse_px": fit.view_rmse_px.tolist(), "left_out": list(lens.left_out),
                      "findings": advice}  # fmt: skip
    return Outcome("\n".join([*lines, f"  written     {args.out}"]), {"lenses": str(args.out), "cameras": data})


def check_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Report whether a capture's calibration fits what was seen."""
    from solver_backend.camera_calibration.calibration_check import check_calibration
    from solver_backend.cli.camera_sources import capture_of

    capture = capture_of(args, progress)
    cameras, keypoints = capture.require_multiview()
    found = check_calibration(cameras, keypoints, progress)
    lines = [f"{args.capture}: {found.verdict}"]
    lines += [
        f"  {name:<11} {rms:5.1f} px, worst part {region} {worst:.1f} px"
        for name, rms, (region, worst) in zip(cameras.names, found.camera_px, found.worst_regions, strict=True)
    ]
    lines += [f"  finding     {sentence(item)}" for item in found.diagnostics]
    lines += [f"  problem     {sentence(item)}" for item in capture.problems]
    data = found.as_dict()
    data["problems"] = [sentence(item) for item in capture.problems]
    data["capture_diagnostics"] = [item.as_dict() for item in capture.problems]
    return Outcome("\n".join(lines), data)


def fit_cameras(args: argparse.Namespace, progress: Progress) -> Outcome:
    """Write a capture's cameras as they were read: corrected, scaled and levelled."""
    from solver_backend.camera_calibration.formats import format_of, write_calibration
    from solver_backend.cli.camera_sources import capture_of
    from solver_backend.io.recognition.world_fit import check_world

    overwrite = args.overwrite
    kind = args.format or format_of(args.out)
    if kind != "colmap":
        check_output(args.out, overwrite=overwrite)
    capture = capture_of(args, progress)
    cameras, keypoints = capture.require_multiview()
    world = check_world(cameras, keypoints)
    write_calibration(args.out, cameras, kind, world.residual_px, overwrite=overwrite)
    lines = [f"{len(cameras)} cameras of {capture.name}, views agree to {world.residual_px:.1f} px"]
    lines += [f"  note        {sentence(item)}" for item in capture.notes]
    lines += [f"  problem     {sentence(item)}" for item in capture.problems]
    data = {"calibration": str(args.out), "format": kind, "cameras": list(cameras.names),
            "residual_px": world.residual_px, "stature_m": world.stature_m}  # fmt: skip
    return Outcome(
        "\n".join([*lines, f"  written     {args.out} ({kind})"]),
        {
            **data,
            "notes": [sentence(item) for item in capture.notes],
            "problems": [sentence(item) for item in capture.problems],
            "diagnostics": [item.as_dict() for item in (*capture.problems, *capture.notes)],
        },
    )


def _outcome(found: Any, path: Path, kind: str) -> Outcome:
    import numpy as np

    cameras = found.cameras
    lines = [f"{len(cameras)} cameras by {found.method}, {found.rmse_px:.2f} px"]
    data = []
    for c, name in enumerate(cameras.names):
        centre = cameras.centres[c]
        sigma_mm, sigma_deg = 1000 * float(found.centre_sigma_m[c]), float(np.degrees(found.turn_sigma[c]))
        lens = found.lenses.get(name, {})
        model = f", {lens['model']} {lens['held_out_px']:.2f} px" if lens else ""
        lines.append(
            f"  {name:<11} {found.camera_rmse_px[c]:.2f} px, at ({centre[0]:.3f}, {centre[1]:.3f}, {centre[2]:.3f}) m "
            f"± {sigma_mm:.1f} mm, ± {sigma_deg:.2f}°, f {cameras.K[c, 0, 0]:.1f} px{model}"
        )
        data.append({"name": name, "rmse_px": float(found.camera_rmse_px[c]), "centre_m": centre.tolist(),
                     "centre_sigma_mm": sigma_mm, "turn_sigma_deg": sigma_deg, "delay_s": float(found.delays_s[c]),
                     **lens})  # fmt: skip
    notes, findings = ([sentence(item) for item in part] for part in (found.notes, found.findings))
    lines += [f"  note        {note}" for note in notes]
    lines += [f"  finding     {finding}" for finding in findings]
    lines.append(f"  written     {path} ({kind})")
    return Outcome(
        "\n".join(lines),
        {"calibration": str(path), "format": kind, "method": found.method, "rmse_px": found.rmse_px, "cameras": data,
         "findings": findings, "notes": notes},
    )  # fmt: skip


def _write_bytes(path: Path, content: bytes, overwrite: bool) -> None:
    from solver_backend.exchange.outputs import atomic_output

    with atomic_output(path, overwrite=overwrite) as place:
        place.write_bytes(content)
