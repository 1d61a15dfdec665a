"""Calibrate cameras from sightings of a board."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Adjusted, Bodies, BodySightings, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import (
    CENTRE,
    FOCAL,
    LENS_MODELS,
    PARAMETERS,
    Lens,
    build_cameras,
    lens_of,
)
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting, point_velocities
from solver_backend.camera_calibration.extrinsics.two_views import (
    CalibratedCameras,
    Pose,
    chained,
    composed,
    inverted,
    relative_pose,
)
from solver_backend.camera_calibration.intrinsics.lens_fit import CORNER_SIGMA_PX, board_poses
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras

FEWEST_TOGETHER = 2
"""Fewest common board sightings of a usable camera pair."""
OUTLIER_SIGMAS = 6.0
"""Larger errors are excluded from the second adjustment, in median errors."""

ZOOM_GAIN = 0.25
"""A camera has another zoom if a free focal length reduces the error by this share. Chosen by hand."""
UNKNOWN_VELOCITY = 10.0
"""Factor on the deviation of points without a velocity while delays are estimated."""


@dataclass(frozen=True)
class BoardCalibration:
    """Result of a board calibration."""

    adjusted: Adjusted
    """Cameras and the board's poses in the first camera's axes."""
    moments: tuple[int, ...]
    seen: BodySightings
    together: dict[tuple[int, int], int]
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
    together, relative = {}, {}
    for i, j in combinations(range(len(names)), 2):
        common = sorted(poses[i].keys() & poses[j].keys())
        if len(common) >= FEWEST_TOGETHER:
            together[i, j] = len(common)
            relative[i, j] = relative_pose([poses[i][f] for f in common], [poses[j][f] for f in common])
    camera_poses = chained(names, together, relative)
    R, t = np.stack([R for R, _ in camera_poses]), np.stack([t for _, t in camera_poses])
    cameras = build_cameras(names, lenses, R, t)
    moments = tuple(sorted(set().union(*(p.keys() for p in poses))))
    bodies, seen = placed_boards(board, sightings, poses, camera_poses, moments, fps)
    late = np.arange(len(names)) > 0 if fps is not None else None
    fixed = Unknowns(np.ones(len(names), bool), np.zeros((len(names), PARAMETERS), bool), delays=late)
    found = adjust(cameras, bodies, seen, fixed, robust_scale=4.0)
    error = np.linalg.norm(found.error, axis=-1)
    kept = error < OUTLIER_SIGMAS * max(float(np.nanmedian(error)), CORNER_SIGMA_PX)
    unknowns = replace(lens_unknowns(found.cameras, lenses), delays=late) if free_lenses else fixed
    found = adjust(found.cameras, found.bodies, seen.where(kept), unknowns, delays=found.delays, robust_scale=4.0)
    return BoardCalibration(found, moments, seen.where(kept), together, int((~kept).sum()))


def zoom_doubts(solved: BoardCalibration) -> tuple[Diagnostic, ...]:
    """Report each camera whose lens was calibrated at another zoom or mode.

    A free focal length must differ by more than 3 % and five standard deviations, and reduce the error by a quarter.
    """
    names, stated = solved.adjusted.cameras.names, solved.adjusted.cameras
    lenses = [lens_of(stated, c) for c in range(len(names))]
    unknowns = replace(lens_unknowns(stated, lenses), lens_sigma=None)
    lens = np.zeros_like(unknowns.lens)
    lens[:, list(FOCAL)] = True
    late = solved.adjusted.delays != 0
    adjusted, free_focal = solved.adjusted, Unknowns(unknowns.poses, lens, delays=late)
    options = {"delays": adjusted.delays, "robust_scale": 8.0, "tolerance": 1e-4, "steps": 25}
    free = adjust(stated, adjusted.bodies, solved.seen, free_focal, **options)
    if free.rmse_px > (1.0 - ZOOM_GAIN) * solved.adjusted.rmse_px:
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
    return Unknowns(np.ones(len(cameras), bool), lens, True, sigma)


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
    """Return the rotation and translation into the world of the board that lies on the floor at a frame, and a note.

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
    that again, so ``σ = |difference| / 2``. The ratio to the covariance is taken over all cameras. Lenses stay fixed.

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
    return replace(
        found,
        centre_sigma_m=_ratio(apart, found.centre_sigma_m) * found.centre_sigma_m,
        turn_sigma=_ratio(turned, found.turn_sigma) * found.turn_sigma,
        notes=(*found.notes, note),
    )


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
