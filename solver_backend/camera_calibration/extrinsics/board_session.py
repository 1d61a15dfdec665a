"""Calibrate cameras from footage of a board."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS, Lens
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardDetector, BoardSighting
from solver_backend.camera_calibration.extrinsics.from_board import (
    BoardCalibration,
    board_world,
    calibrate_from_board,
    widen_by_halves,
    zoom_doubts,
)
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras, moved_world, result_of
from solver_backend.camera_calibration.intrinsics.known_lenses import CameraLens, camera_lens, choose_family, in_family
from solver_backend.camera_calibration.intrinsics.lens_fit import coverage_svg, write_coverage_png
from solver_backend.camera_calibration.pictures import VIDEOS, grey_frames, is_footage
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic, sentence
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, CaptureNotRecognised, FileMissing
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.camera_names import natural_key
from solver_backend.io.footage import join_chapters

_LENS = ("intrinsics", "intrinsic", "lens", "lenses")
_EXTRINSIC = ("extrinsics", "extrinsic", "calibration", "board", "rig")  # the last is a word of users


@dataclass(frozen=True)
class BoardFootage:
    """Video or folder of pictures of each camera."""

    lens: dict[str, Path]
    extrinsic: dict[str, Path]
    """Footage of the board seen by several cameras at once. May be empty."""


def board_footage(folder: Path) -> BoardFootage:
    """Return the footage in ``intrinsics/`` and ``extrinsics/`` of a folder or below, or else its own videos.

    A camera is a video, a folder of pictures or of one video, or a folder with one such folder in it.
    ``int_cam01_img`` is camera ``cam01``, chapters of an action camera are one video.

    Raises:
        FileMissing: there is no such folder.
        CaptureNotRecognised: it has no videos and no pictures.
    """
    if not folder.is_dir():
        raise FileMissing("There is no such folder.", where=str(folder))
    lens, extrinsic = _below(folder, _LENS), _below(folder, _EXTRINSIC)
    if not lens and not extrinsic:
        extrinsic = _cameras(folder)
    if not lens and not extrinsic:
        hint = "Put one video a camera into it, or into its folders intrinsics and extrinsics."
        raise CaptureNotRecognised("The folder holds no pictures of a board.", where=str(folder), hint=hint)
    return BoardFootage(lens, extrinsic)


def _below(folder: Path, names: tuple[str, ...], levels: int = 2) -> dict[str, Path]:
    folders = sorted(p for p in folder.iterdir() if p.is_dir())
    for path in folders:
        if path.name.lower() in names and (found := _cameras(path)):
            return found
    if levels > 1:
        for path in folders:
            if found := _below(path, names, levels - 1):
                return found
    return {}


def _cameras(folder: Path) -> dict[str, Path]:
    entries = sorted((p for p in folder.iterdir() if not p.name.startswith(".")), key=lambda p: natural_key(p.name))
    videos = join_chapters(path for path in entries if path.suffix.lower() in VIDEOS and path.is_file())
    found = {camera_name(parts[0]): parts[0] for parts in videos}
    for path in entries:
        if path.is_dir() and (footage := _footage_in(path)) is not None:
            found.setdefault(camera_name(path), footage)
    return found


def _footage_in(folder: Path) -> Path | None:
    if is_footage(folder):
        return folder
    videos = join_chapters(path for path in folder.iterdir() if path.suffix.lower() in VIDEOS and path.is_file())
    if len(videos) == 1:
        return videos[0][0]
    inner = [path for path in sorted(folder.iterdir()) if path.is_dir() and is_footage(path)]
    return inner[0] if len(inner) == 1 else None


def camera_name(path: Path) -> str:
    """Return the camera's name from a file's or folder's name."""
    stem = path.stem if path.suffix.lower() in VIDEOS else path.name
    plain = re.sub(r"^(int|ext|intrinsics?|extrinsics?|calib)[_\-]", "", stem, flags=re.IGNORECASE)
    return re.sub(r"[_\-](img|imgs|int|ext|images|calib)$", "", plain, flags=re.IGNORECASE) or stem


Sightings = dict[int, BoardSighting]
GOOD_RMSE_PX = 1.0
"""Largest error of a good board calibration in pixels. Chosen by hand."""


@dataclass(frozen=True)
class BoardOptions:
    """Options of a board calibration."""

    models: tuple[str, ...] = tuple(LENS_MODELS)
    """Lens models to choose from."""
    step: int = 1
    """Step between the used frames of lens videos. All frames for the poses are used."""
    fps: float | None = None
    """Frames per second of the videos for the poses, needed to estimate delays."""
    origin_frame: int | None = None
    """Frame at which the board lies on the floor and defines origin and axes of the world."""
    refine_lenses: bool = False
    """Adjust lenses together with the poses."""


def find_boards(path: Path, board: Board, step: int = 1) -> tuple[Sightings, tuple[int, int]]:
    """Return the board's sightings in footage by frame, and the pictures' width and height."""
    detector = BoardDetector(board)
    found: Sightings = {}
    size = (0, 0)
    for number, picture in grey_frames(path, step):
        size = (picture.shape[1], picture.shape[0])
        if (sighting := detector.find(picture)) is not None:
            found[number] = sighting
    return found, size


def calibrate_lenses(
    footage: dict[str, Path], board: Board, options: BoardOptions = BoardOptions(), progress: Progress = silent
) -> tuple[dict[str, CameraLens], dict[str, list[BoardSighting]]]:
    """Return each camera's lens, and the sightings that it was fitted to.

    Raises:
        CalibrationInvalid: a camera has too few pictures of the board.
    """
    lenses, used = {}, {}
    for done, (name, path) in enumerate(footage.items()):
        progress(f"Lens of {name}", done, len(footage))
        sightings, size = find_boards(path, board, options.step)
        try:
            lenses[name] = camera_lens(board, sightings, size, options.models, name)
        except CalibrationInvalid as error:
            raise CalibrationInvalid(error.message, where=f"camera {name}, {path}", hint=error.hint) from error
        used[name] = [sightings[f] for f in lenses[name].frames]
    return lenses, used


def calibrate_by_board(
    footage: BoardFootage,
    board: Board,
    known: dict[str, Lens],
    options: BoardOptions = BoardOptions(),
    progress: Progress = silent,
    *,
    coverage: Path | None = None,
) -> CalibratedCameras:
    """Calibrate cameras by a board that was carried through their views.

    Args:
        known: known lens of each camera.
        coverage: folder for pictures (SVG and PNG) of the board's places in each view.

    Raises:
        CalibrationMissing: there is no footage for the poses.
        CalibrationInvalid: a lens or a pose cannot be found.
    """
    if len(footage.extrinsic) < 2:
        message = f"{len(footage.extrinsic)} cameras filmed the board at once; two are needed."
        raise CalibrationMissing(message, hint="Put one video a camera into the folder extrinsics.")
    names = tuple(footage.extrinsic)
    seen, sizes = [], []
    for done, (name, path) in enumerate(footage.extrinsic.items()):
        progress(f"Board before {name}", done, len(names))
        sightings, size = find_boards(path, board)
        seen.append(sightings)
        sizes.append(size)
    if coverage is not None:
        for name, sightings, size in zip(names, seen, sizes, strict=True):
            picture = coverage_svg(list(sightings.values()), size, name)
            write_text(coverage / f"{name}.svg", picture, overwrite=True)
            write_coverage_png(list(sightings.values()), size, coverage / f"{name}.png")
    lenses = _lenses(footage, board, known, seen, sizes, options, progress)
    findings = _mirrored(names, seen)
    ordered = [lenses[n][0] for n in names]
    progress("All cameras at once", 0, 1)
    moving = options.fps is not None and all(p.suffix.lower() in VIDEOS for p in footage.extrinsic.values())
    solved = calibrate_from_board(
        names, ordered, board, seen, free_lenses=options.refine_lenses, fps=options.fps if moving else None
    )
    progress("Halves of the footage", 0, 1)
    found = widen_by_halves(result_of("board", solved.adjusted), ordered, board, seen)
    R, t, note = _world(solved, options.origin_frame)
    measured = {n: lens for n in names if (lens := lenses[n][1]) is not None}
    advice = [item for lens in measured.values() for item in lens.advice]
    figures: dict[str, Any] = {"count": len(solved.moments), "left_out": solved.left_out}
    return replace(
        moved_world(found, R, t),
        findings=(*findings, *_doubts(names, found, solved), *zoom_doubts(solved), *found.findings, *advice),
        notes=(note, *found.notes, diagnostic("calibration_evidence", evidence="board", board=str(board), **figures)),
        lenses={n: _facts(lens) for n, lens in measured.items()},
    )


def _lenses(
    footage: BoardFootage,
    board: Board,
    known: dict[str, Lens],
    seen: Sequence[Sightings],
    sizes: Sequence[tuple[int, int]],
    options: BoardOptions,
    progress: Progress,
) -> dict[str, tuple[Lens, CameraLens | None]]:
    """Return each camera's lens, and its measurement unless it was known.

    It is measured in its own footage, or else in that for the poses. All measured lenses have the distortion model of
    the known lenses, or the one that predicts best.
    """
    own = {n: p for n, p in footage.lens.items() if n in footage.extrinsic and n not in known}
    found, views = calibrate_lenses(own, board, options, progress)
    for i, name in enumerate(footage.extrinsic):
        if name not in known and name not in found:
            try:
                found[name] = camera_lens(board, seen[i], sizes[i], options.models, name)
            except CalibrationInvalid as error:
                raise CalibrationInvalid(error.message, where=f"camera {name}", hint=error.hint) from error
            views[name] = [seen[i][f] for f in found[name].frames]
    families = {known[n].distortion_model for n in footage.extrinsic if n in known}
    family = families.pop() if len(families) == 1 else choose_family(found, options.models)
    if family is not None:
        found = {n: in_family(board, lens, views[n], family, options.models) for n, lens in found.items()}
    return {n: (known[n], None) if n in known else (found[n].lens, found[n]) for n in footage.extrinsic}


def _facts(lens: CameraLens) -> dict[str, object]:
    return {
        "model": lens.choice.fit.model.name,
        "held_out_px": lens.choice.held_out,
        "pictures": len(lens.frames),
        "focal_sigma_px": lens.choice.fit.focal_sigma_px,
        "advice": [sentence(item) for item in lens.advice],
    }


def _mirrored(names: Sequence[str], seen: Sequence[Sightings]) -> tuple[Diagnostic, ...]:
    words: list[Diagnostic] = []
    for name, sightings in zip(names, seen, strict=True):
        mirrored = sum(s.mirrored for s in sightings.values())
        if sightings and mirrored > len(sightings) / 2:
            message = f"The board is mirrored in {mirrored} of {len(sightings)} pictures."
            hint = "Switch the camera's mirroring (selfie view) off, or turn the printed sheet over."
            raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
        if mirrored:
            words.append(diagnostic("board_mirrored", cameras=[name], count=mirrored))
    return tuple(words)


def _doubts(names: Sequence[str], found: CalibratedCameras, solved: BoardCalibration) -> tuple[Diagnostic, ...]:
    words: list[Diagnostic] = []
    for c, name in enumerate(names):
        if found.camera_rmse_px[c] > GOOD_RMSE_PX:
            size = found.camera_rmse_px[c]
            words.append(diagnostic("camera_off", reference="board", unit="px", cameras=[name], size=size))
        if abs(found.delays_s[c]) > 0.005:
            way = "later" if found.delays_s[c] > 0 else "earlier"
            late_ms = abs(found.delays_s[c]) * 1000
            words.append(diagnostic("camera_delayed", cameras=[name, names[0]], way=way, size=late_ms))
    share = solved.left_out / max(len(solved.seen.px) + solved.left_out, 1)
    if share > 0.1:
        words.append(diagnostic("observations_contradict", kind="corners", percent=100 * share))
    return tuple(words)


def _world(solved: BoardCalibration, origin: int | None) -> tuple[np.ndarray, np.ndarray, Diagnostic]:
    bodies = solved.adjusted.bodies
    if origin is not None:
        return board_world(bodies, solved.moments, origin)
    cameras = solved.adjusted.cameras
    up = -cameras.R[:, 1].mean(0)
    z = up / max(float(np.linalg.norm(up)), 1e-9)
    x = np.cross(cameras.R[0, 2], z)
    x = x / max(float(np.linalg.norm(x)), 1e-9)
    R = np.stack([x, np.cross(z, x), z])
    centre = np.median(bodies.t, axis=0)
    return R, -R @ centre, diagnostic("world_origin", source="cameras")
