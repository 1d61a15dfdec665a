"""Adjust a real board and a real person together: ``python -m tests.benchmarks.caliscope_together CAPTURE.npz``.

Caliscope's board videos show the man who carries the board. Cameras are adjusted on half of the moments, drawn at
random, by the board, by the person and by both. The other half evaluates them: corners with a free board, detections
with free points. ``manifold cameras detect FOLDER/calibration/extrinsic --calibration FOLDER/camera_array.toml --sync
none --out CAPTURE.npz`` makes the capture of the person from the same videos.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.adjustment.bundle import Unknowns, adjust
from solver_backend.camera_calibration.adjustment.lens import PARAMETERS
from solver_backend.camera_calibration.boards.board import board_named
from solver_backend.camera_calibration.boards.footage import board_footage, find_boards
from solver_backend.camera_calibration.extrinsics.together import (
    Evidence,
    board_evidence,
    calibrate_together,
    person_evidence,
)
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.load import load_capture
from solver_backend.types import Cameras
from tests.benchmarks.bench_calibration import CALISCOPE
from tests.support.recordings import recordings_folder

SPLITS = 6


def main(argv: list[str]) -> int:
    """Print the median errors on unused moments, as medians of the splits."""
    folder = recordings_folder() / CALISCOPE
    kept = read_calibration(folder / "camera_array.toml").cameras
    board = board_named(str(folder / "charuco.toml"))
    seen = [find_boards(path, board)[0] for path in board_footage(folder).extrinsic.values()]
    keypoints = load_capture(Path(argv[0])).keypoints
    assert keypoints is not None

    def told(cameras: Cameras, moments: np.ndarray) -> dict[str, Evidence]:
        some = [{f: view for f, view in views.items() if f in set(moments.tolist())} for views in seen]
        part = replace(keypoints, xy=keypoints.xy[:, moments], confidence=keypoints.confidence[:, moments])
        return {"board": board_evidence(cameras, board, some), "person": person_evidence(cameras, part)}

    rng, errors = np.random.default_rng(0), {}
    for _ in range(SPLITS):
        order = rng.permutation(keypoints.num_frames)
        used, unused = (np.sort(half) for half in np.array_split(order, 2))
        by = told(kept, used)
        for name, sources in {"kept array": [], **{n: [e] for n, e in by.items()}, "both": list(by.values())}.items():
            cameras = calibrate_together(kept, sources).cameras if sources else kept
            off = [_median_px(cameras, evidence) for evidence in told(cameras, unused).values()]
            errors.setdefault(name, []).append(off)
    for name, found in errors.items():
        board_px, person_px = np.median(found, axis=0)
        sys.stdout.write(f"{name:<12} board {board_px:.2f} px, person {person_px:.2f} px\n")
    return 0


def _median_px(cameras: Cameras, evidence: Evidence) -> float:
    """Return the median pixel distance of sightings from the best-fitting bodies in these cameras."""
    nothing = Unknowns(np.zeros(len(cameras), bool), np.zeros((len(cameras), PARAMETERS), bool))
    found = adjust(cameras, evidence.bodies, evidence.seen, nothing, robust_scale=4.0)
    return float(np.median(np.linalg.norm(found.error, axis=1)))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
