"""Calibrate cameras from footage of a calibration board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Adjusted, Bodies, BodySightings, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import LENS_MODELS, Lens, build_cameras, lens_mask
from solver_backend.camera_calibration.boards.board import Board, BoardSighting, point_velocities
from solver_backend.camera_calibration.boards.footage import BoardFootage, Sightings, find_boards, find_together
from solver_backend.camera_calibration.extrinsics import two_views
from solver_backend.camera_calibration.extrinsics.two_views import CalibratedCameras, Pose
from solver_backend.camera_calibration.intrinsics import lens_fit
from solver_backend.camera_calibration.intrinsics.lens_fit import CORNER_SIGMA_PX, CameraLens
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, sentence
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.geometry.small_matrices import unit
from solver_backend.types import Cameras

FEWEST_TOGETHER = 2  # Minimum number of sightings that a usable pair of cameras has in common.
OUTLIER_SIGMAS = 6.0  # Largest error in the second adjustment, in multiples of the median error.
ZOOM_GAIN = 0.25  # Smallest error reduction by a free focal length that indicates a zoom. Chosen by hand.
UNKNOWN_VELOCITY = 10.0  # Factor on the deviation of points with unknown velocity when delays are estimated.


@dataclass(frozen=True)
class BoardCalibration:
    """Cameras and board poses estimated from board footage."""

    adjusted: Adjusted  # Cameras and board poses in the first camera's axes.
    moments: tuple[int, ...]  # Frames that show the board in any camera.
    left_out: int  # Number of board points that were excluded.


def calibrate_from_board(
    names: Sequence[str],
    lenses: Sequence[Lens],
    board: Board,
    sightings: Sequence[Mapping[int, BoardSighting]],
    *,
    free_lenses: bool = False,
    fps: float | None = None,
) -> BoardCalibration:
    """Estimate camera poses from a board: chain pairs of cameras, then adjust all cameras jointly.

    Args:
        sightings: board sightings of each camera, by synchronised frame number.
        fps: frame rate in 1/s, needed to estimate each camera's delay relative to the first. None ignores delays.

    Raises:
        CalibrationInvalid: cameras never see the board together, or the board looks the same after rotation by 180°.
    """
    if not board.ends_differ:
        message = f"The {board} looks the same after half a turn, so its orientation is ambiguous."
        hint = "Use a Charuco board, or a checkerboard with an even and an odd number of squares."
        raise CalibrationInvalid(message, hint=hint)
    poses = [poses_seen(board, seen, lens) for seen, lens in zip(sightings, lenses, strict=True)]
    moments = tuple(sorted(set().union(*poses)))

    def pair(i: int, j: int, both: np.ndarray) -> tuple[Pose, int]:
        common = [moments[m] for m in np.flatnonzero(both)]
        return two_views.relative_pose([poses[i][f] for f in common], [poses[j][f] for f in common]), len(common)

    seen_at = np.array([[f in one for f in moments] for one in poses], dtype=bool)
    camera_poses = two_views.chained(names, seen_at, FEWEST_TOGETHER, pair)
    R, t = np.stack([R for R, _ in camera_poses]), np.stack([t for _, t in camera_poses])
    cameras = build_cameras(names, lenses, R, t)
    bodies, seen = placed_boards(board, sightings, poses, camera_poses, moments, fps)
    late = np.arange(len(names)) > 0 if fps is not None else None
    fixed = Unknowns(np.ones(len(names), bool), delays=late)
    found = adjust(cameras, bodies, seen, fixed, robust_scale=4.0)
    error = np.linalg.norm(found.error, axis=-1)
    kept = error < OUTLIER_SIGMAS * max(float(np.nanmedian(error)), CORNER_SIGMA_PX)
    unknowns = replace(lens_unknowns(lenses), delays=late) if free_lenses else fixed
    found = adjust(found.cameras, found.bodies, seen.select(kept), unknowns, delays=found.delays, robust_scale=4.0)
    return BoardCalibration(found, moments, int((~kept).sum()))


def zoom_doubts(solved: BoardCalibration) -> tuple[Diagnostic, ...]:
    """Report each camera whose zoom or recording mode seems to differ from its lens calibration.

    The focal lengths of all cameras are estimated again. A camera is reported if its focal length changes by more than
    3 % and five standard deviations, provided that the error of all cameras decreases by a quarter.
    """
    adjusted, names = solved.adjusted, solved.adjusted.cameras.names
    stated = adjusted.cameras
    lens = np.tile(lens_mask(), (len(names), 1))
    free_focal = Unknowns(np.ones(len(names), bool), lens, delays=adjusted.delays != 0)
    options = {"delays": adjusted.delays, "robust_scale": 8.0, "tolerance": 1e-4, "steps": 25}
    free = adjust(stated, adjusted.bodies, solved.adjusted.seen, free_focal, **options)
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


def lens_unknowns(lenses: Sequence[Lens]) -> Unknowns:
    """Mark all poses and lens parameters as unknown, except distortion coefficients that are zero."""
    fitted = [np.flatnonzero(lens.distortion) for lens in lenses]
    default = LENS_MODELS["radial2"].fitted
    free = np.stack([lens_mask(used if len(used) else default, centre=True) for used in fitted])
    return Unknowns(np.ones(len(lenses), bool), free, np.tile(np.repeat([0.03, 0.3], [4, 8]), (len(lenses), 1)))


def poses_seen(board: Board, seen: Mapping[int, BoardSighting], lens: Lens) -> dict[int, Pose]:
    """Estimate the board's pose in one camera's axes for each frame that shows the board."""
    if not seen:
        return {}
    R, t = lens_fit.board_poses(board, list(seen.values()), lens)
    return {frame: (R[i], t[i]) for i, frame in enumerate(seen)}


def placed_boards(
    board: Board,
    sightings: Sequence[Mapping[int, BoardSighting]],
    poses: Sequence[Mapping[int, Pose]],
    cameras: Sequence[Pose],
    moments: Sequence[int],
    fps: float | None,
) -> tuple[Bodies, BodySightings]:
    """Return the board's pose in each frame, and all observed board points.

    The pose in a frame comes from the camera that sees most board points. If ``fps`` is given, image velocities are
    estimated. A point with an unknown velocity gets a small weight. ``moments`` are the frames with a sighting.
    """
    number = {frame: i for i, frame in enumerate(moments)}
    best: dict[int, tuple[int, Pose]] = {}
    rows = []
    for c, by_frame in enumerate(sightings):
        for frame, view in by_frame.items():
            world = two_views.composed(two_views.inverted(cameras[c]), poses[c][frame])
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
    bodies: Bodies, moments: Sequence[int | str], origin: int, first: int = 0
) -> tuple[np.ndarray, np.ndarray, Diagnostic]:
    """Place the floor at the board in frame ``origin``. Return the rotation and translation to this world, and a note.

    Args:
        moments: frame of each body.
        origin: frame that shows the board on the floor.
        first: index of the body that belongs to the first frame in ``moments``.
    """
    if origin not in moments:
        hint = f"Choose a frame with the board. The first one is {moments[0]}, and the last one {moments[-1]}."
        raise CalibrationInvalid(f"The board is not visible at frame {origin}.", hint=hint)
    i = first + moments.index(origin)
    R = np.diag([1.0, -1.0, -1.0]) @ bodies.R[i].T
    return R, -R @ bodies.t[i], diagnostic("world_origin", source="board", frame=origin)


def widen_by_halves(
    found: CalibratedCameras, lenses: Sequence[Lens], board: Board, seen: Sequence[Mapping[int, BoardSighting]]
) -> CalibratedCameras:
    """Enlarge the standard deviations of cameras to match the difference between two halves of the footage.

    The errors of corners in the same image are correlated (lens model, flatness, print), so a covariance for
    independent corners is too small. A calibration from all footage has a variance σ², and one from half of
    the footage 2 σ². The difference between two halves has the variance 4 σ², so that ``σ = |difference| / 2``. The
    deviations of all centres are enlarged by one factor, and all rotations by another. The lenses stay fixed.
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
    """Align two camera arrays. Return the remaining differences (C,) of centres (m) and rotations (rad)."""
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


GOOD_RMSE_PX = 1.0  # Largest error of a good board calibration, in pixels. Chosen by hand.
LATE_S = 0.005  # Smallest camera delay that is reported, in seconds. Chosen by hand.


@dataclass(frozen=True)
class BoardOptions:
    """Options for a board calibration."""

    models: tuple[str, ...] = tuple(LENS_MODELS)  # Lens models to choose from.
    fps: float | None = None  # Frame rate in 1/s of the videos for the poses, needed to estimate delays.
    origin_frame: int | None = None  # Frame in which the board lies on the floor and defines the origin and axes.
    refine_lenses: bool = False  # Adjust lens parameters together with the poses.


def calibrate_lenses(
    footage: dict[str, Path], board: Board, options: BoardOptions = BoardOptions(), progress: Progress = silent
) -> dict[str, CameraLens]:
    """Calibrate the lens of each camera from its board footage."""
    lenses = {}
    for done, (name, path) in enumerate(footage.items()):
        progress(f"Lens of {name}", done, len(footage))
        lenses[name] = _lens(name, path, board, *find_boards(path, board), options)
    return lenses


def _lens(
    name: str, path: Path, board: Board, seen: Sightings, size: tuple[int, int], options: BoardOptions
) -> CameraLens:
    try:
        return lens_fit.camera_lens(board, seen, size, options.models, name)
    except CalibrationInvalid as error:
        raise CalibrationInvalid(error.message, where=f"camera {name}, {path}", hint=error.hint) from error


def calibrate_by_board(
    footage: BoardFootage,
    board: Board,
    known: dict[str, Lens],
    options: BoardOptions = BoardOptions(),
    progress: Progress = silent,
    *,
    coverage: Path | None = None,
) -> CalibratedCameras:
    """Calibrate cameras from videos of a board that a person moves through the cameras' views.

    Args:
        known: lenses that are already calibrated, by camera name.
        coverage: folder for one image per camera that shows the detected board corners.
    """
    names = tuple(footage.extrinsic)
    if len(names) < 2:
        message = f"{len(names)} cameras filmed the board, but two are needed."
        raise CalibrationMissing(message, hint="Put one video per camera in the folder 'extrinsics'.")
    seen, sizes = find_together(footage, names, board, progress)
    if coverage is not None:
        for name, sightings, size in zip(names, seen, sizes, strict=True):
            lens_fit.write_coverage(list(sightings.values()), size, coverage / f"{name}.png")
    measured = _measured_lenses(footage, board, known, seen, sizes, options, progress)
    findings = _mirrored(names, seen)
    lenses = [known.get(name) or measured[name].lens for name in names]
    progress("All cameras at once", 0, 1)
    fps = options.fps if footage.moving else None
    solved = calibrate_from_board(names, lenses, board, seen, free_lenses=options.refine_lenses, fps=fps)
    progress("Halves of the footage", 0, 1)
    found = widen_by_halves(two_views.result_of("board", solved.adjusted), lenses, board, seen)
    R, t, note = _world(solved, options.origin_frame)
    doubts = (*_doubts(names, found, solved), *zoom_doubts(solved), *found.findings)
    advice = (item for lens in measured.values() for item in lens.advice)
    figures: dict[str, Any] = {"count": len(solved.moments), "left_out": solved.left_out}
    evidence = diagnostic("calibration_evidence", evidence="board", board=str(board), **figures)
    facts: dict[str, dict[str, object]] = {}
    for name, lens in measured.items():
        facts[name] = {"model": lens.fit.model.name, "held_out_px": lens.held_out, "pictures": len(lens.frames)}
        facts[name] |= {"focal_sigma_px": lens.fit.focal_sigma_px, "advice": list(map(sentence, lens.advice))}
    words = {"findings": (*findings, *doubts, *advice), "notes": (note, *found.notes, evidence), "lenses": facts}
    return replace(two_views.moved_world(found, R, t), **words)


def _measured_lenses(
    footage: BoardFootage,
    board: Board,
    known: dict[str, Lens],
    seen: Sequence[Sightings],
    sizes: Sequence[tuple[int, int]],
    options: BoardOptions,
    progress: Progress,
) -> dict[str, CameraLens]:
    """Calibrate each unknown lens from its intrinsic footage, or else from the extrinsic footage.

    All lenses get the distortion model of the known lenses, or else the model that ``choose_family`` selects.
    """
    wanted = [name for name in footage.extrinsic if name not in known]
    found = calibrate_lenses({n: footage.lens[n] for n in wanted if n in footage.lens}, board, options, progress)
    for (name, path), sightings, size in zip(footage.extrinsic.items(), seen, sizes, strict=True):
        if name in wanted and name not in found:
            found[name] = _lens(name, path, board, sightings, size, options)
    families = {known[name].distortion_model for name in footage.extrinsic if name in known}
    family = families.pop() if len(families) == 1 else lens_fit.choose_family(found, options.models)
    if family is None:
        return {name: found[name] for name in wanted}
    return {name: lens_fit.in_family(board, found[name], family, options.models) for name in wanted}


def _mirrored(names: Sequence[str], seen: Sequence[Sightings]) -> tuple[Diagnostic, ...]:
    words: list[Diagnostic] = []
    for name, sightings in zip(names, seen, strict=True):
        mirrored = sum(s.mirrored for s in sightings.values())
        if sightings and mirrored > len(sightings) / 2:
            message = f"The board is mirrored in {mirrored} of {len(sightings)} images."
            hint = "Turn off the camera's mirroring (selfie view), or turn the printed sheet over."
            raise CalibrationInvalid(message, where=f"camera {name}", hint=hint)
        if mirrored:
            words.append(diagnostic("board_mirrored", cameras=[name], count=mirrored))
    return tuple(words)


def _doubts(names: Sequence[str], found: CalibratedCameras, solved: BoardCalibration) -> tuple[Diagnostic, ...]:
    words: list[Diagnostic] = []
    for name, rmse_px, late_s in zip(names, found.camera_rmse_px, found.delays_s, strict=True):
        if rmse_px > GOOD_RMSE_PX:
            words.append(diagnostic("camera_off", cameras=[name], reference="board", unit="px", size=rmse_px))
        if abs(late_s) > LATE_S:
            way, late_ms = "later" if late_s > 0 else "earlier", abs(late_s) * 1000
            words.append(diagnostic("camera_delayed", cameras=[name, names[0]], way=way, size=late_ms))
    share = solved.left_out / max(len(solved.adjusted.seen.px) + solved.left_out, 1)
    if share > 0.1:
        words.append(diagnostic("observations_contradict", kind="corners", percent=100 * share))
    return tuple(words)


def _world(solved: BoardCalibration, origin: int | None) -> tuple[np.ndarray, np.ndarray, Diagnostic]:
    bodies = solved.adjusted.bodies
    if origin is not None:
        return board_world(bodies, solved.moments, origin)
    cameras = solved.adjusted.cameras
    z = unit(-cameras.R[:, 1].mean(0))
    x = unit(np.cross(cameras.R[0, 2], z))
    R = np.stack([x, np.cross(z, x), z])
    centre = np.median(bodies.t, axis=0)
    return R, -R @ centre, diagnostic("world_origin", source="cameras")
