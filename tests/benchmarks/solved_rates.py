"""What is left of a frame rate's signs in solved takes: clips of CMU through four views, as stated, doubled and halved.

Detections are off as a detector's are; the solver's priors go by the rate that is stated. Prints a row a clip.
``python -m tests.benchmarks.solved_rates [clip ...]``, clips by folder and name (``mb2/06_02``). Needs the motions kept
beside the repository (or MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.report.time_plausibility import CHANGE, motion_rate
from solver_backend.types import Capture, JointSet, Keypoints2D
from tests.support.foreign_clips import cmu_limbs
from tests.support.recordings import recordings_folder
from tests.support.scenes import ring_of_cameras

CLIPS = (
    "mb2/06_02", "mb2/07_04", "mb2/08_11", "mb2/12_01", "mb2/10_04", "mb2/35_17", "mb2/35_20", "mb2/13_29", "mb2/32_01",
    "daz/salsa_05", "daz/martial_05",
)  # fmt: skip
"""Walks (a slow one, one of long slow strides), runs, exercises, a dance and a fight that no limit was chosen on."""
FRAMES, STEP = 150, 2
"""Of a clip at most, every second: 5 s at 30 frames a second."""
RADIUS_M, OFF_PX = 7.0, 4.0
"""Distance of the cameras; standard deviation of the detections."""


def captured(name: str) -> Capture:
    """Return a clip seen by four cameras, at its own rate."""
    points, fps = cmu_limbs(recordings_folder() / "motion_cmu" / f"{name}.npz")
    points, joint_set = points[: FRAMES * STEP : STEP], JointSet.COCO_17
    ankles = points[:, [joint_set.keypoints.index(f"{side}_ankle") for side in ("left", "right")]]
    middle = np.nanmedian(points[..., :2], axis=(0, 1))
    points = points - [*middle, float(np.quantile(ankles[..., 2].min(1), 0.1)) - 0.08]
    cameras = ring_of_cameras(4, RADIUS_M, 2.0)
    xy = project(cameras, points)
    xy = xy + np.random.default_rng(0).normal(0.0, OFF_PX, xy.shape)
    confidence = np.where(np.isfinite(xy).all(-1), 0.8, 0.0)
    return Capture(name, cameras, Keypoints2D(xy, confidence, joint_set, fps / STEP))


def main(names: list[str]) -> int:
    """Solve clips at three rates and print what each shows."""
    for name in names or CLIPS:
        capture = captured(name)
        assert capture.keypoints is not None
        shown = []
        for factor in (1.0, CHANGE, 1 / CHANGE):
            stated = replace(capture.keypoints, fps=factor * capture.keypoints.fps)
            shown.append(motion_rate(solve(replace(capture, keypoints=stated), SolveSettings()).motion))
        sys.stdout.write(f"{name}: " + ", ".join(f"{factor:g} {by or 'nothing'}" for factor, by in shown) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
