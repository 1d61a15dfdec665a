"""Measure how well caliscope's board videos determine its cameras: ``python -m tests.benchmarks.caliscope_halves``.

Times are split at random, and cameras of both halves are compared after a similarity: from the board, and with every
corner as a separate point, as caliscope adjusts. The deviation of a solution from all times is half as large.
"""

from __future__ import annotations

import sys

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import lens_of
from solver_backend.camera_calibration.boards.board import board_named
from solver_backend.camera_calibration.boards.footage import board_footage, find_boards
from solver_backend.camera_calibration.extrinsics.board_session import calibrate_from_board
from solver_backend.io.calibration.read import read_calibration
from solver_backend.types import Cameras
from tests.benchmarks.bench_calibration import CALISCOPE, apart, corners_alone
from tests.support.recordings import recordings_folder

SPLITS = 8


def main() -> int:
    """Print the root mean square difference of halves, and the distances of both kinds to the stored array."""
    folder = recordings_folder() / CALISCOPE
    kept = read_calibration(folder / "camera_array.toml").cameras
    board = board_named(str(folder / "charuco.toml"))
    seen = [find_boards(path, board)[0] for path in board_footage(folder).extrinsic.values()]
    known = [lens_of(kept, c) for c in range(len(kept))]

    def both(chosen: set[int]) -> tuple[Cameras, Cameras]:
        some = [{f: view for f, view in views.items() if f in chosen} for views in seen]
        rig = calibrate_from_board(kept.names, known, board, some)
        return rig.adjusted.cameras, corners_alone(rig)

    moments, rng = sorted(set().union(*seen)), np.random.default_rng(0)
    for name, cameras in zip(("board", "corners alone"), both(set(moments)), strict=True):
        _say(f"{name}: from the kept array", *apart(cameras, kept.R, kept.t, with_scale=True))
    squares = np.zeros((2, 2, len(kept)))
    for _ in range(SPLITS):
        first = set(rng.permutation(moments)[: len(moments) // 2].tolist())
        pairs = zip(both(first), both(set(moments) - first), strict=True)
        squares += [np.square(apart(a, b.R, b.t, with_scale=True)) for a, b in pairs]
    for name, of_kind in zip(("board", "corners alone"), np.sqrt(squares / SPLITS), strict=True):
        _say(f"{name}: between halves", *of_kind)
    return 0


def _say(what: str, far_mm: np.ndarray, turned_deg: np.ndarray) -> None:
    sys.stdout.write(f"{what}: {np.round(far_mm, 1)} mm, {np.round(turned_deg, 2)} deg\n")
    sys.stdout.flush()


if __name__ == "__main__":
    raise SystemExit(main())
