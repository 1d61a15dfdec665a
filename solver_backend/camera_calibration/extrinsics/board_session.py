"""Calibrate cameras from footage of a board."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Adjusted, Bodies, BodySightings, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import (
    CENTRE,
    FOCAL,
    LENS_MODELS,
    PARAMETERS,
    Lens,
    build_cameras,
)
from solver_backend.camera_calibration.boards.board import Board, BoardDetector, BoardSighting, point_velocities
from solver_backend.camera_calibration.extrinsics.two_views import (
    CalibratedCameras,
    Pose,
    chained,
    composed,
    inverted,
    moved_world,
    relative_pose,
    result_of,
)
from solver_backend.camera_calibration.intrinsics.known_lenses import CameraLens, camera_lens, choose_family, in_family
from solver_backend.camera_calibration.intrinsics.lens_fit import (
    CORNER_SIGMA_PX,
    board_poses,
    coverage_svg,
    write_coverage_png,
)
from solver_backend.camera_calibration.pictures import VIDEOS, grey_frames, is_footage
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, sentence
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, CaptureNotRecognised, FileMissing
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.camera_names import natural_key
from solver_backend.io.footage import join_chapters
from solver_backend.types import Cameras

FEWEST_TOGETHER = 2  # Fewest common board sightings of a usable camera pair.
OUTLIER_SIGMAS = 6.0  # Larger errors are excluded from the second adjustment, in median errors.
ZOOM_GAIN = 0.25  # A camera has another zoom if a free focal length reduces the error by this share. Chosen by hand.
UNKNOWN_VELOCITY = 10.0  # Factor on the deviation of points without a velocity while delays are estimated.


@dataclass(frozen=True)
class BoardCalibration:
    """Result of a board calibration."""

    adjusted: Adjusted
    """Cameras and the board's poses in the first camera's axes."""
    moments: tuple[int, ...]
    seen: BodySightings
    left_out: int
    """Number of excluded sightings."""


def calibrate_from_board(
    names: Sequence[str],
    lenses: Sequence[Lens],
    board: Board,
    sightings: Sequence[Mapping[int, BoardSighting]],
    *,
    free_lenses: bool = False,
    fps: float | None = None,
) -> BoardCalibration:
    """Find camera poses from a board: chain the pairs, then adjust all cameras at once.

    Args:
        sightings: sightings of each camera by the number of the synchronous frame.
        fps: frames per second, to estimate each camera's delay against the first. None for no delays.

    Raises:
        CalibrationInvalid: cameras never see the board together, or its ends look the same.
    """
    if not board.ends_differ:
        message = f"The {board} looks the same when half turned, so cameras cannot agree on its ends."
        hint = "Use a Charuco board, or a checkerboard with an even and an odd number of squares."
        raise CalibrationInvalid(message, hint=hint)
    poses = [poses_seen(board, seen, lens) for seen, lens in zip(sightings, lenses, strict=True)]
    moments = tuple(sorted(set().union(*poses)))

    def pair(i: int, j: int, both: np.ndarray) -> tuple[Pose, int]:
        common = [moments[m] for m in np.flatnonzero(both)]
        return relative_pose([poses[i][f] for f in common], [poses[j][f] for f in common]), len(common)

    seen_at = np.array([[f in one for f in moments] for one in poses], dtype=bool)
    camera_poses = chained(names, seen_at, FEWEST_TOGETHER, pair)
    R, t = np.stack([R for R, _ in camera_poses]), np.stack([t for _, t in camera_poses])
    cameras = build_cameras(names, lenses, R, t)
    bodies, seen = placed_boards(board, sightings, poses, camera_poses, moments, fps)
    late = np.arange(len(names)) > 0 if fps is not None else None
    fixed = Unknowns(np.ones(len(names), bool), delays=late)
    found = adjust(cameras, bodies, seen, fixed, robust_scale=4.0)
    error = np.linalg.norm(found.error, axis=-1)
    kept = error < OUTLIER_SIGMAS * max(float(np.nanmedian(error)), CORNER_SIGMA_PX)
    unknowns = replace(lens_unknowns(found.cameras, lenses), delays=late) if free_lenses else fixed
    found = adjust(found.cameras, found.bodies, seen.where(kept), unknowns, delays=found.delays, robust_scale=4.0)
    return BoardCalibration(found, moments, seen.where(kept), int((~kept).sum()))


def zoom_doubts(solved: BoardCalibration) -> tuple[Diagnostic, ...]:
    """Report each camera with a lens of another zoom or mode.

    A free focal length must differ by more than 3 % and five standard deviations, and reduce the error by a quarter.
    """
    adjusted, names = solved.adjusted, solved.adjusted.cameras.names
    stated = adjusted.cameras
    lens = np.zeros((len(names), PARAMETERS), bool)
    lens[:, list(FOCAL)] = True
    free_focal = Unknowns(np.ones(len(names), bool), lens, delays=adjusted.delays != 0)
    options = {"delays": adjusted.delays, "robust_scale": 8.0, "tolerance": 1e-4, "steps": 25}
    free = adjust(stated, adjusted.bodies, solved.seen, free_focal, **options)
    if free.rmse_px > (1.0 - ZOOM_GAIN) * adjusted.rmse_px:
        return ()
    sigma = np.sqrt(np.diag(free.covariance)).reshape(len(names), -1)[:, 6] * max(free.rmse_px / CORNER_SIGMA_PX, 1.0)
    focal = [cameras.K[:, 0, 0] for cameras in (stated, free.cameras)]
    change = np.log(focal[1] / focal[0])
    far = (np.abs(change) > 0.03) & (np.abs(change) > 5.0 * sigma)
    worst = np.abs(change) > 0.5 * np.abs(change).max()
    return tuple(
        diagnostic("lens_of_another_zoom", cameras=[names[c]], size=focal[1][c], stated=focal[0][c])
        for c in np.flatnonzero(far & worst)
    )


def lens_unknowns(cameras: Cameras, lenses: Sequence[Lens]) -> Unknowns:
    """Return unknowns for all poses and lenses: focal length, centre, and coefficients that are not zero."""
    lens = np.zeros((len(cameras), PARAMETERS), bool)
    lens[:, [*FOCAL, *CENTRE]] = True
    for c, one in enumerate(lenses):
        used = np.flatnonzero(one.distortion)
        lens[c, 4 + used] = True
        if not len(used):
            lens[c, [4 + i for i in LENS_MODELS["radial2"].fitted]] = True
    sigma = np.tile(np.array([0.03] * 2 + [0.03] * 2 + [0.3] * 8), (len(cameras), 1))
    return Unknowns(np.ones(len(cameras), bool), lens, sigma)


def poses_seen(board: Board, seen: Mapping[int, BoardSighting], lens: Lens) -> dict[int, Pose]:
    """Return the board's pose in a camera's axes at each moment with a sighting."""
    if not seen:
        return {}
    R, t = board_poses(board, list(seen.values()), lens)
    return {frame: (R[i], t[i]) for i, frame in enumerate(seen)}


def placed_boards(
    board: Board,
    sightings: Sequence[Mapping[int, BoardSighting]],
    poses: Sequence[Mapping[int, Pose]],
    cameras: Sequence[Pose],
    moments: Sequence[int],
    fps: float | None,
) -> tuple[Bodies, BodySightings]:
    """Return the board's poses, each from the camera that sees most of it, and all sightings.

    With ``fps``, points have velocities, and those without one get a small weight.
    """
    number = {frame: i for i, frame in enumerate(moments)}
    best: dict[int, tuple[int, Pose]] = {}
    rows = []
    for c, by_frame in enumerate(sightings):
        for frame, view in by_frame.items():
            world = composed(inverted(cameras[c]), poses[c][frame])
            if frame not in best or len(view.ids) > best[frame][0]:
                best[frame] = len(view.ids), world
            n = len(view.ids)
            velocity = np.zeros((n, 2)) if fps is None else point_velocities(by_frame, frame, fps)
            rows.append((np.full(n, c), np.full(n, number[frame]), board.points[view.ids], view.px, velocity))
    camera, body, local, px, velocity = (np.concatenate(part) for part in zip(*rows, strict=True))
    known = np.isfinite(velocity).all(-1)
    sigma = np.where(known, CORNER_SIGMA_PX, UNKNOWN_VELOCITY * CORNER_SIGMA_PX)
    velocity = np.where(known[:, None], velocity, 0.0) if fps is not None else None
    placed = [best[frame][1] for frame in moments]
    bodies = Bodies(np.stack([R for R, _ in placed]), np.stack([t for _, t in placed]))
    return bodies, BodySightings(camera, body, local, px, sigma, velocity)


def board_world(
    bodies: Bodies, moments: Sequence[int], origin: int, first: int = 0
) -> tuple[np.ndarray, np.ndarray, Diagnostic]:
    """Return the rotation and translation into the world of the board on the floor at a frame, and a note.

    Args:
        first: index of the body of the first moment.

    Raises:
        CalibrationInvalid: the board is not seen at that frame.
    """
    if origin not in moments:
        hint = f"It is at {moments[0]} to {moments[-1]}."
        raise CalibrationInvalid(f"The board is not seen at frame {origin}.", hint=hint)
    i = first + moments.index(origin)
    R = np.diag([1.0, -1.0, -1.0]) @ bodies.R[i].T
    return R, -R @ bodies.t[i], diagnostic("world_origin", source="board", frame=origin)


def widen_by_halves(
    found: CalibratedCameras, lenses: Sequence[Lens], board: Board, seen: Sequence[Mapping[int, BoardSighting]]
) -> CalibratedCameras:
    """Widen the deviations of a calibration to the difference between two halves of its footage.

    The errors of the corners of one picture are correlated (lens model, flatness, print), so the covariance of
    independent corners is too small. A half has twice the variance of the whole, and the difference of two halves twice
    that again, so ``σ = |difference| / 2``. All cameras have one ratio to the covariance. Lenses stay fixed.

    Args:
        seen: sightings of each camera by the frame's number.
    """
    moments = sorted(set().union(*seen))
    halves: list[Cameras] = []
    try:
        for part in range(2):
            kept = set(moments[part::2])
            half = [{f: sighting for f, sighting in one.items() if f in kept} for one in seen]
            halves.append(calibrate_from_board(found.cameras.names, lenses, board, half).adjusted.cameras)
    except (CalibrationInvalid, np.linalg.LinAlgError):
        short = diagnostic("halves_differ", result="short", severity=Severity.WARNING)
        return replace(found, findings=(*found.findings, short))
    apart, turned = _difference(*halves)
    note = diagnostic("halves_differ", result="size", size=1000 * np.median(apart), angle=np.degrees(np.median(turned)))
    centre, turn = (_ratio(apart, found.centre_sigma_m), _ratio(turned, found.turn_sigma))
    sigmas = {"centre_sigma_m": centre * found.centre_sigma_m, "turn_sigma": turn * found.turn_sigma}
    return replace(found, notes=(*found.notes, note), **sigmas)


def _difference(one: Cameras, other: Cameras) -> tuple[np.ndarray, np.ndarray]:
    """Return the (C,) differences in metres and radians of two aligned camera arrays."""
    arm = np.linalg.norm(other.centres - other.centres.mean(0), axis=1).mean()
    ends = [
        (c.centres[:, None] + arm * np.concatenate([np.zeros((1, 3)), np.eye(3)]) @ c.R).reshape(-1, 3)
        for c in (one, other)
    ]
    _, R, t = umeyama(*ends)
    apart = np.linalg.norm(one.centres @ R.T + t - other.centres, axis=1)
    return apart, np.linalg.norm(log_so3(one.R @ R.T @ other.R.swapaxes(-1, -2)), axis=-1)


def _ratio(difference: np.ndarray, sigma: np.ndarray) -> float:
    claimed = float(np.sqrt((sigma**2).mean()))
    return max(1.0, 0.5 * float(np.sqrt((difference**2).mean())) / max(claimed, 1e-12))


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

    models: tuple[str, ...] = tuple(LENS_MODELS)  # Lens models to choose from.
    step: int = 1  # Step between the used frames of lens videos. All frames for the poses are used.
    fps: float | None = None  # Frames per second of the videos for the poses, needed to estimate delays.
    origin_frame: int | None = None  # Frame with the board on the floor, which defines origin and axes of the world.
    refine_lenses: bool = False  # Adjust lenses together with the poses.


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
        lenses[name], used[name] = _lens(name, path, board, *find_boards(path, board, options.step), options)
    return lenses, used


def _lens(
    name: str, path: Path, board: Board, seen: Sightings, size: tuple[int, int], options: BoardOptions
) -> tuple[CameraLens, list[BoardSighting]]:
    try:
        lens = camera_lens(board, seen, size, options.models, name)
    except CalibrationInvalid as error:
        raise CalibrationInvalid(error.message, where=f"camera {name}, {path}", hint=error.hint) from error
    return lens, [seen[f] for f in lens.frames]


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
    moving = all(path.suffix.lower() in VIDEOS for path in footage.extrinsic.values())
    timing = {"free_lenses": options.refine_lenses, "fps": options.fps if moving else None}
    solved = calibrate_from_board(names, ordered, board, seen, **timing)
    progress("Halves of the footage", 0, 1)
    found = widen_by_halves(result_of("board", solved.adjusted), ordered, board, seen)
    R, t, note = _world(solved, options.origin_frame)
    measured = {n: lens for n in names if (lens := lenses[n][1]) is not None}
    doubts = (*_doubts(names, found, solved), *zoom_doubts(solved), *found.findings)
    advice = (item for lens in measured.values() for item in lens.advice)
    figures: dict[str, Any] = {"count": len(solved.moments), "left_out": solved.left_out}
    evidence = diagnostic("calibration_evidence", evidence="board", board=str(board), **figures)
    facts = {n: _facts(lens) for n, lens in measured.items()}
    words = {"findings": (*findings, *doubts, *advice), "notes": (note, *found.notes, evidence), "lenses": facts}
    return replace(moved_world(found, R, t), **words)


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
    for i, (name, path) in enumerate(footage.extrinsic.items()):
        if name not in known and name not in found:
            found[name], views[name] = _lens(name, path, board, seen[i], sizes[i], options)
    families = {known[n].distortion_model for n in footage.extrinsic if n in known}
    family = families.pop() if len(families) == 1 else choose_family(found, options.models)
    if family is not None:
        found = {n: in_family(board, lens, views[n], family, options.models) for n, lens in found.items()}
    return {n: (known[n], None) if n in known else (found[n].lens, found[n]) for n in footage.extrinsic}


def _facts(lens: CameraLens) -> dict[str, object]:
    fit = lens.choice.fit
    facts: dict[str, object] = {"model": fit.model.name, "held_out_px": lens.choice.held_out}
    facts |= {"pictures": len(lens.frames), "focal_sigma_px": fit.focal_sigma_px}
    return facts | {"advice": [sentence(item) for item in lens.advice]}


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
            figures = {"reference": "board", "unit": "px", "size": found.camera_rmse_px[c]}
            words.append(diagnostic("camera_off", cameras=[name], **figures))
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
