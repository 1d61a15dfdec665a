"""Calibrate cameras from a board, from its pictures and from a person. Compare with stored and known cameras.

Caliscope: only its four board videos, compared with the array solved from them that is stored with them. Errors of both
arrays are on the same corners, with a free board. Pose2Sim: lenses from its checkerboard pictures, with the error of
pictures left out. Person: the benchmark captures' keypoints with true lenses, centres after a similarity, compared with
the true cameras, and joints of solves with true and with found cameras. Real: the Pose2Sim trial, refined and
calibrated from one half of its frames, with each camera held out in the other half.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Bodies, Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import PARAMETERS, lens_of
from solver_backend.camera_calibration.boards.board import board_named
from solver_backend.camera_calibration.boards.footage import board_footage, find_boards
from solver_backend.camera_calibration.extrinsics.board_session import (
    BoardCalibration,
    calibrate_from_board,
    calibrate_lenses,
)
from solver_backend.camera_calibration.extrinsics.person_session import calibrate_by_person, refine_by_person
from solver_backend.fitters import solve
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.load import load_capture
from solver_backend.metrics import mpjpe_mm
from solver_backend.types import Cameras, Capture
from tests.benchmarks.comparison.captures import TAKES, filmed
from tests.benchmarks.holdout import leave_one_camera_out
from tests.benchmarks.kept_parts import kept_metrics
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import ABSENT, BALANCING_TRIAL, recordings_folder

CALISCOPE = Path("multiview/caliscope/charuco_calibration")
PICTURES = Path("multiview/pose2sim/S00_Calibration")
PEOPLE = TAKES[:3]
LINEAR, LEFT_OUT = 50.0, 0.05
"""Penalty scale that makes all residuals count equally, and fraction of sightings that caliscope leaves out."""


def run() -> list[Metric]:
    """Measure all four parts."""
    folder = recordings_folder()
    if not (folder / CALISCOPE).is_dir():
        raise BenchmarkSkipped("The recordings are not here.", hint=ABSENT)
    parts = {
        "board": partial(by_board, folder / CALISCOPE), "lenses": partial(lenses, folder / PICTURES),
        "person": by_person, "real": partial(real, folder / BALANCING_TRIAL),
    }  # fmt: skip
    found = (kept_metrics("tests.benchmarks.bench_calibration", name, measure) for name, measure in parts.items())
    return [metric for metrics in found for metric in metrics]


def by_board(folder: Path) -> list[Metric]:
    """Return errors of the stored array and of ours with its lenses, without and with delays."""
    kept = read_calibration(folder / "camera_array.toml").cameras
    board = board_named(str(folder / "charuco.toml"))
    seen = [find_boards(path, board)[0] for path in board_footage(folder).extrinsic.values()]
    known = [lens_of(kept, c) for c in range(len(kept))]
    metrics = []
    for name, fps in (("plain", None), ("delays", 6.0)):
        rig = calibrate_from_board(kept.names, known, board, seen, fps=fps)
        far, turned = apart(rig.adjusted.cameras, kept.R, kept.t, with_scale=False)
        metrics += [
            Metric(f"caliscope_{name}_px", rig.adjusted.rmse_px, "px"),
            Metric(f"caliscope_{name}_kept_array_px", _of_kept(kept, rig), "px"),
            Metric(f"caliscope_{name}_centres_mm", float(far.max()), "mm"),
            Metric(f"caliscope_{name}_directions_deg", float(turned.max()), "deg"),
        ]
        if fps is None:
            far, turned = apart(corners_alone(rig), kept.R, kept.t, with_scale=False)
            metrics += [
                Metric("caliscope_corners_alone_centres_mm", float(far.max()), "mm"),
                Metric("caliscope_corners_alone_directions_deg", float(turned.max()), "deg"),
            ]
    return metrics


def corners_alone(rig: BoardCalibration) -> Cameras:
    """Return the cameras with every corner of every moment as a separate point, without the worst sightings.

    Caliscope adjusts its arrays in this way. The board only initialises the cameras, and its flatness and size have no
    effect afterwards.
    """
    found, seen = rig.adjusted, rig.adjusted.seen
    corner = np.unique(np.column_stack([seen.body, np.round(1e5 * seen.local)]), axis=0, return_inverse=True)[1]
    placed = np.einsum("nij,nj->ni", found.bodies.R[seen.body], seen.local) + found.bodies.t[seen.body]
    kept, cameras = np.ones(len(corner), bool), found.cameras
    unknowns = Unknowns(np.arange(len(cameras)) > 0, np.zeros((len(cameras), PARAMETERS), bool))
    for _ in range(2):
        kept &= (np.bincount(corner[kept], minlength=corner.max() + 1) >= 2)[corner]
        _, first, body = np.unique(corner[kept], return_index=True, return_inverse=True)
        points = placed[kept][first]
        bodies = Bodies(np.tile(np.eye(3), (len(points), 1, 1)), points)
        alone = replace(seen.select(kept), body=body, local=np.zeros((len(body), 3)), velocity=None)
        adjusted = adjust(cameras, bodies, alone, unknowns, robust_scale=LINEAR, gauge=7)
        far = np.linalg.norm(adjusted.error, axis=1)
        cameras = adjusted.cameras
        kept[np.flatnonzero(kept)[far > np.quantile(far, 1.0 - LEFT_OUT)]] = False
    return cameras


def _of_kept(kept: Cameras, rig: BoardCalibration) -> float:
    """Return the error of the stored cameras on the same corners, with the board's poses adjusted to them."""
    found = rig.adjusted
    R = _mean_turn(found.cameras, kept.R)
    t = kept.centres.mean(0) - (found.cameras.centres @ R.T).mean(0)
    bodies = Bodies(R @ found.bodies.R, found.bodies.t @ R.T + t)
    nothing = Unknowns(np.zeros(len(kept), bool), np.zeros((len(kept), PARAMETERS), bool))
    return adjust(kept, bodies, replace(rig.adjusted.seen, velocity=None), nothing, robust_scale=4.0).rmse_px


def lenses(folder: Path) -> list[Metric]:
    """Return the error of pictures left out, for each camera."""
    found = calibrate_lenses(board_footage(folder).lens, board_named("checkerboard:5x8:60mm"))
    kept = read_calibration(folder / "Calib.qca.txt").cameras.K[:, 0, 0]
    metrics = [Metric(f"lens_{name}_px", lens.held_out, "px") for name, lens in found.items()]
    off = [abs(lens.lens.K[0, 0] / f - 1) for lens, f in zip(found.values(), kept, strict=True)]
    return [*metrics, Metric("lens_focal_off", 100 * max(off), "%")]


def by_person() -> list[Metric]:
    """Return the errors of cameras estimated from keypoints alone, and of a solve with them."""
    metrics = []
    for number, take in enumerate(PEOPLE):
        capture = filmed(take)
        assert capture.cameras is not None and capture.keypoints is not None
        true = replace(capture.cameras, R=capture.truth["R"], t=capture.truth["t"])
        known = [lens_of(true, c) for c in range(len(true))]
        found = calibrate_by_person(true.names, known, capture.keypoints)
        far, turned = apart(found.cameras, true.R, true.t, with_scale=True)
        metrics += [
            Metric(f"person{number}_centres_mm", float(far.max()), "mm"),
            Metric(f"person{number}_directions_deg", float(turned.max()), "deg"),
        ]
        if number == 0:
            metrics.append(Metric("person0_solve_ratio", _solve_ratio(capture, true, found.cameras), ""))
    return metrics


def _solve_ratio(capture: Capture, true: Cameras, found: Cameras) -> float:
    """Return the ratio of joint errors with found and true cameras. Found cameras are aligned by a similarity."""
    s, _, _ = umeyama(found.centres, true.centres, with_scale=True)
    R = _mean_turn(found, true.R)
    t = true.centres.mean(0) - s * (found.centres @ R.T).mean(0)
    turned = found.R @ R.T
    laid = replace(found, R=turned, t=s * found.t - (turned @ t[:, None])[..., 0])
    errors = []
    for cameras in (laid, true):
        motion = solve(replace(capture, cameras=cameras)).motion
        errors.append(mpjpe_mm(motion.joints[:, :22], capture.truth["joints"][:, :22]))
    return errors[0] / errors[1]


def real(folder: Path) -> list[Metric]:
    """Return the median distance at a held-out camera over the second half of the trial."""
    capture = load_capture(folder)
    cameras, keypoints = capture.require_multiview()
    half = keypoints.num_frames // 2
    first, rest = keypoints.frames(0, half), second_half(capture)
    known = [lens_of(cameras, c) for c in range(len(cameras))]
    rigs = {
        "own": cameras,
        "refined": refine_by_person(cameras, first).cameras,
        "person": calibrate_by_person(cameras.names, known, first, stature_m=1.72).cameras,
    }
    held = {name: leave_one_camera_out(replace(rest, cameras=rig)).pooled_px[0] for name, rig in rigs.items()}
    return [Metric(f"real_{name}_held_out_px", value, "px") for name, value in held.items()]


def second_half(capture: Capture) -> Capture:
    """Return the second half of a capture with only the person who is solved."""
    _, keypoints = capture.require_multiview()
    return replace(capture, keypoints=keypoints.frames(keypoints.num_frames // 2, keypoints.num_frames), people=())


def apart(found: Cameras, R: np.ndarray, t: np.ndarray, *, with_scale: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return (C,) distances of centres in mm and (C,) angles of directions in degrees, after the best alignment."""
    centres = -np.einsum("cji,cj->ci", R, t)
    s, turn, shift = umeyama(found.centres, centres, with_scale=with_scale)
    far = np.linalg.norm(s * found.centres @ np.asarray(turn).T + shift - centres, axis=1)
    turned = log_so3(R @ _mean_turn(found, R) @ np.swapaxes(found.R, 1, 2))
    return 1000 * far, np.degrees(np.linalg.norm(turned, axis=1))


def _mean_turn(found: Cameras, R: np.ndarray) -> np.ndarray:
    """Return the world rotation that best aligns the cameras' directions."""
    U, _, Vt = np.linalg.svd(np.einsum("cki,ckj->ij", R, found.R))
    return U @ Vt
