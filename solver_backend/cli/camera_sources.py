"""Calibrate cameras and lenses from board footage, a capture, uncalibrated detections, or clicks."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS, Lens, lens_of, rough_lens
from solver_backend.camera_calibration.boards.board import Board, board_named
from solver_backend.camera_calibration.boards.footage import board_footage, find_together
from solver_backend.camera_calibration.extrinsics import board_session, person_session, together
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras, moved_world
from solver_backend.camera_calibration.intrinsics.known_lenses import known_lenses
from solver_backend.camera_calibration.intrinsics.lens_fit import CameraLens, write_coverage
from solver_backend.cli.arguments import given_world, reading
from solver_backend.exchange.errors import CalibrationMismatch, CalibrationMissing, CommandLineInvalid
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.calibration.search import levels_above
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources, read_config
from solver_backend.io.footage import find_footage, read_video_header
from solver_backend.io.load import load_capture
from solver_backend.types import Cameras, Capture, Keypoints2D

_WORLD_OPTIONS = {"person": {"stature"}, "refine": {"stature", "scale", "level"}}
"""World settings that these calibration methods use. Other methods use only the scale."""


def calibrated(args: argparse.Namespace, progress: Progress) -> CalibratedCameras:
    """Calibrate cameras with the method and options from the command line."""
    by = {"board": _by_board, "person": _by_person, "points": _by_points, "refine": _refined, "together": _together}
    world = given_world(args)
    useless = sorted(set(world) - _WORLD_OPTIONS.get(args.method, {"scale"}))
    if useless:
        hint = "Write the calibration, then scale and level it with a take (`cameras fit TAKE --out CALIBRATION`)."
        raise CommandLineInvalid(f"--from {args.method} does not use --{useless[0]}.", hint=hint)
    found = by[args.method](args, progress)
    if args.method != "refine" and "scale" in world:
        found = moved_world(found, np.eye(3), np.zeros(3), WorldSettings(**world).scale)
    return found


def capture_of(args: argparse.Namespace, progress: Progress, path: Path | None = None) -> Capture:
    """Read the capture at ``path``, or the capture on the command line if ``path`` is None."""
    given = args.capture if "capture" in args else args.source
    return load_capture(path or given, **reading(args), progress=progress)


def calibrated_lenses(args: argparse.Namespace, progress: Progress) -> dict[str, CameraLens]:
    """Estimate the lens of each camera that recorded a calibration board."""
    board, options = _board_options(args)
    footage = board_footage(args.source)
    lenses = board_session.calibrate_lenses(footage.lens or footage.extrinsic, board, options, progress)
    if args.coverage is not None:
        for name, found in lenses.items():
            write_coverage(found.views, found.lens.image_size, args.coverage / f"{name}.png")
    return lenses


def _board_options(args: argparse.Namespace) -> tuple[Board, board_session.BoardOptions]:
    folder = args.footage or args.source
    there = (folder / name for name in ("board.toml", "charuco.toml"))
    given = args.board or next((str(path) for path in there if path.is_file()), None)
    if given is None:
        hint = "Add --board, for example --board charuco:5x7:35mm."
        raise CommandLineInvalid("The calibration board is unknown.", hint=hint)
    models = tuple(name for name in LENS_MODELS if not args.lens or name in args.lens)
    return board_named(given), board_session.BoardOptions(models, args.fps, args.origin, args.refine_lenses)


def _by_board(args: argparse.Namespace, progress: Progress) -> CalibratedCameras:
    board, options = _board_options(args)
    footage = board_footage(args.source)
    known = known_lenses(args.lenses, tuple(footage.extrinsic)) if args.lenses is not None else {}
    return board_session.calibrate_by_board(footage, board, known, options, progress, coverage=args.coverage)


def _by_person(args: argparse.Namespace, progress: Progress) -> CalibratedCameras:
    length = None
    if args.length is not None:
        try:
            length = args.length[0], args.length[1], float(args.length[2])
        except ValueError as error:
            raise CommandLineInvalid("--length needs two keypoints and a distance in metres.") from error
    names, lenses, keypoints, rough = _person(args, progress)
    progress("Cameras from the person", 0, 1)
    facts = {"stature_m": args.stature, "known_length": length, "free_focal": rough or args.refine_lenses}
    return person_session.calibrate_by_person(names, lenses, keypoints, **facts)


def _person(args: argparse.Namespace, progress: Progress) -> tuple[Sequence[str], list[Lens], Keypoints2D, bool]:
    """Return camera names, lenses, a person's keypoints, and whether the lenses are approximate."""
    try:
        cameras, keypoints = capture_of(args, progress).require_multiview()
    except (CalibrationMissing, CalibrationMismatch):
        return _uncalibrated(args, progress)
    if args.lenses is not None:
        known = known_lenses(args.lenses, cameras.names)
        return cameras.names, [known[n] for n in cameras.names], keypoints, False
    return cameras.names, [lens_of(cameras, c) for c in range(len(cameras))], keypoints, False


def _uncalibrated(args: argparse.Namespace, progress: Progress) -> tuple[Sequence[str], list[Lens], Keypoints2D, bool]:
    """Return the values of ``_person`` for the largest person in detections from uncalibrated cameras."""
    sources = camera_sources(args.source)
    levels = levels_above(args.source)
    config = read_config(levels)
    detections = read_detections(sources, configured=config.joint_set, trim=args.trim, progress=progress)
    names = tuple(sources)
    videos = [read_video_header(path) for path in find_footage(levels[:2], names)]
    fps = args.fps or config.fps or next((v.fps for v in videos if v is not None), 60.0)
    keypoints = person_session.main_person(detections, fps)
    if args.lenses is not None:
        known = known_lenses(args.lenses, names)
        return names, [known[n] for n in names], keypoints, False
    if any(v is None for v in videos):
        hint = "Specify the lenses with --lenses, or put the videos next to the detections."
        message = "The lenses and the image sizes are unknown."
        raise CalibrationMissing(message, where=str(args.source), hint=hint)
    return names, [rough_lens(v.size) for v in videos if v is not None], keypoints, True


def _by_points(args: argparse.Namespace, progress: Progress) -> CalibratedCameras:
    clicks = together.read_clicks(args.source)
    if args.lenses is None:
        raise CommandLineInvalid("Clicked points need lenses.", hint="Set them with --lenses CALIBRATION|LENSES.json.")
    progress("Cameras from clicks", 0, 1)
    return together.calibrate_by_points(clicks, known_lenses(args.lenses, tuple(clicks.px)))


def _refined(args: argparse.Namespace, progress: Progress) -> CalibratedCameras:
    cameras, keypoints = capture_of(args, progress).require_multiview()
    progress("Cameras from the person", 0, 1)
    return person_session.refine_by_person(cameras, keypoints, free_focal=args.refine_lenses)


def _together(args: argparse.Namespace, progress: Progress) -> CalibratedCameras:
    """Refine a calibration with any combination of a filmed board, a person and clicked points."""
    if args.footage is None and args.take is None and args.clicks is None:
        hint = "Specify at least one of --footage, --take and --clicks."
        raise CommandLineInvalid("--from together needs a source.", hint=hint)
    if args.hold is not None and not args.hold > 0:
        raise CommandLineInvalid("--hold is the accuracy of the calibration, and must be above 0 mm.")
    start, sources = read_calibration(args.source).cameras, []
    if args.clicks is not None:
        clicks = together.read_clicks(args.clicks)
        _known_cameras(tuple(clicks.px), start.names, args.clicks)
        start = together.in_world_of(clicks, start, with_scale=args.hold is None)
        sources.append(together.clicks_evidence(start, clicks))
    if args.footage is not None:
        sources.append(_board_evidence(args, start, progress))
    if args.take is not None:
        cameras, keypoints = capture_of(args, progress, args.take).require_multiview()
        _known_cameras(cameras.names, start.names, args.take)
        if len(cameras) != len(start):
            missing = ", ".join(n for n in start.names if n not in cameras.names)
            raise CalibrationMismatch(f"The take has no recordings from the cameras {missing}.", where=str(args.take))
        sources.append(together.person_evidence(start, keypoints.views([cameras.names.index(n) for n in start.names])))
    progress("All sources at once", 0, 1)
    hold_m = None if args.hold is None else 1e-3 * args.hold
    return together.calibrate_together(start, sources, hold_m=hold_m, origin_frame=args.origin)


def _board_evidence(args: argparse.Namespace, start: Cameras, progress: Progress) -> together.Evidence:
    board, options = _board_options(args)
    footage = board_footage(args.footage)
    _known_cameras(tuple(footage.extrinsic), start.names, args.footage)
    sightings, _ = find_together(footage, start.names, board, progress)
    return together.board_evidence(start, board, sightings, options.fps if footage.moving else None)


def _known_cameras(names: Sequence[str], known: Sequence[str], path: Path) -> None:
    strange = [name for name in names if name not in known]
    if strange:
        raise CalibrationMismatch(
            f"The calibration has no cameras {', '.join(strange)}. It has {', '.join(known)}.", where=str(path)
        )
