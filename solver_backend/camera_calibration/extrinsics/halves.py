"""Deviations of a board's calibration that agree with what halves of its footage show.

Errors of one picture's corners are correlated (the lens' model, the board's flatness, its printing), so that a
covariance of independent corners claims too little: tenths of a millimetre where halves of the pictures differ by a
whole one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.camera_calibration.extrinsics.from_board import calibrate_from_board
from solver_backend.camera_calibration.extrinsics.result import CalibratedCameras
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Cameras


def widen_by_halves(
    found: CalibratedCameras,
    lenses: Sequence[Lens],
    board: Board,
    seen: Sequence[Mapping[int, BoardSighting]],
) -> CalibratedCameras:
    """Return a calibration whose deviations are at least those that halves of the footage show.

    A half has twice the variance of the whole, and two halves differ by twice that again: ``σ = |difference| / 2``. The
    ratio to what the covariance claims is taken over all cameras, for places and for directions. Lenses stay: how sure
    they are is reported with them.

    Args:
        found: by all of the footage.
        lenses: of C cameras.
        board: what was filmed.
        seen: of each camera, what it saw by the frame's number.
    """
    moments = sorted(set().union(*seen))
    halves: list[Cameras] = []
    try:
        for part in range(2):
            kept = set(moments[part::2])
            half = [{f: sighting for f, sighting in one.items() if f in kept} for one in seen]
            halves.append(calibrate_from_board(found.cameras.names, lenses, board, half).adjusted.cameras)
    except (CalibrationInvalid, np.linalg.LinAlgError):
        return replace(found, findings=(*found.findings, diagnostic("halves_short")))
    apart, turned = _difference(*halves)
    note = diagnostic("halves_differ", size=1000 * np.median(apart), angle=np.degrees(np.median(turned)))
    return replace(
        found, centre_sigma_m=_ratio(apart, found.centre_sigma_m) * found.centre_sigma_m,
        turn_sigma=_ratio(turned, found.turn_sigma) * found.turn_sigma, notes=(*found.notes, note),
    )  # fmt: skip


def _difference(one: Cameras, other: Cameras) -> tuple[np.ndarray, np.ndarray]:
    """Return (C,) metres and radians between two camera arrays, laid on each other by centres and axes."""
    arm = np.linalg.norm(other.centres - other.centres.mean(0), axis=1).mean()
    ends = [(c.centres[:, None] + arm * np.concatenate([np.zeros((1, 3)), np.eye(3)]) @ c.R).reshape(-1, 3)
            for c in (one, other)]  # fmt: skip
    _, R, t = umeyama(*ends)
    apart = np.linalg.norm(one.centres @ R.T + t - other.centres, axis=1)
    return apart, np.linalg.norm(log_so3(one.R @ R.T @ other.R.swapaxes(-1, -2)), axis=-1)


def _ratio(difference: np.ndarray, sigma: np.ndarray) -> float:
    claimed = float(np.sqrt((sigma**2).mean()))
    return max(1.0, 0.5 * float(np.sqrt((difference**2).mean())) / max(claimed, 1e-12))
