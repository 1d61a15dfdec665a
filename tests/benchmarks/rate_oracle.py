"""How well a doubled or halved frame rate could be recognised from the true joints of recorded people at best.

Speeds, accelerations and jerks of the limbs of CMU's clips at their rate and at twice or half of it; a logistic
regression is fitted to all subjects but one and evaluated on that one. ``python -m tests.benchmarks.rate_oracle``.
Needs the motions kept beside the repository (or MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from solver_backend.report.time_plausibility import CHANGE
from solver_backend.types import JointSet
from tests.support.foreign_clips import cmu_limbs
from tests.support.recordings import recordings_folder

SMOOTHING_S = 0.045
"""As ``report.frame_rate.balance``."""
FALSE = 2
"""Clips that may be taken for others at their own rate, as by what ships."""
PENALTY = 1.0
"""Of the squared weights; 1 is the best of 1, 10 and 100 on these clips."""
_NAMES = JointSet.COCO_17.keypoints


def features(points: np.ndarray, fps: float, orders: int) -> np.ndarray:
    """Return logarithms of root mean square derivatives of six groups of limbs, in leg lengths.

    Args:
        points: (F, 17, 3) of COCO, metres.
        fps: frames a second as stated.
        orders: 2 for speed and acceleration, 3 with jerk.
    """

    def both(name: str) -> list[np.ndarray]:
        return [points[:, _NAMES.index(f"{side}_{name}")] for side in ("left", "right")]

    hips, knees, ankles = both("hip"), both("knee"), both("ankle")
    pelvis = sum(hips) / 2
    bones = [
        np.linalg.norm(a - b, axis=1) for a, b in (*zip(hips, knees, strict=True), *zip(knees, ankles, strict=True))
    ]
    leg = 2 * float(np.nanmedian(np.concatenate(bones)))
    limbs = [[x - pelvis for x in both(name)] for name in ("wrist", "elbow", "ankle", "knee")]
    groups = [[pelvis], *limbs, [sum(both("shoulder")) / 2 - pelvis]]
    return np.concatenate([_derivatives(group, leg, fps)[:orders] for group in groups])


def _derivatives(group: list[np.ndarray], leg: float, fps: float) -> np.ndarray:
    """Return (3,) logarithms of root mean squares of speed, acceleration and jerk."""
    sigma, squares = SMOOTHING_S * fps, np.zeros(3)
    reach, end = int(4 * sigma) + 1, int(3 * sigma) + 2
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    for x in group:
        padded = np.pad(x / leg, ((reach, reach), (0, 0)), mode="edge")
        d = np.stack([np.convolve(column, weight / weight.sum(), "valid") for column in padded.T], axis=1)
        for order in range(3):
            d = np.gradient(d, axis=0) * fps
            squares[order] += (d[end:-end] ** 2).sum(1).mean() / len(group)
    return 0.5 * np.log(squares + 1e-4)


def fitted(rows: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return weights of a logistic regression of columns with a constant last, by Newton's method."""
    penalty = PENALTY * np.eye(rows.shape[1])
    penalty[-1, -1] = 1e-6
    weights = np.zeros(rows.shape[1])
    for _ in range(30):
        p = 1.0 / (1.0 + np.exp(-np.clip(rows @ weights, -30.0, 30.0)))
        hessian = (rows * (p * (1.0 - p))[:, None]).T @ rows + penalty
        weights = weights - np.linalg.solve(hessian, rows.T @ (p - labels) + penalty @ weights)
    return weights


def scores(own: np.ndarray, changed: np.ndarray, subjects: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) scores of clips at their own rate and at the changed one, by regressions without their subject."""
    found = np.zeros((2, len(own)))
    for subject in np.unique(subjects):
        rest, here = subjects != subject, subjects == subject
        rows = np.concatenate([own[rest], changed[rest]])
        mean, spread = rows.mean(0), rows.std(0) + 1e-9
        design = [np.c_[(x - mean) / spread, np.ones(len(x))] for x in (rows, own[here], changed[here])]
        weights = fitted(design[0], np.r_[np.zeros(rest.sum()), np.ones(rest.sum())])
        found[0, here], found[1, here] = design[1] @ weights, design[2] @ weights
    return found[0], found[1]


def main() -> int:
    """Print the area under the curve, and what is noticed at the limit that leaves ``FALSE`` clips false."""
    clips: list[Path] = sorted((recordings_folder() / "motion_cmu" / "asfamc").glob("*.npz"))
    subjects = np.array([clip.stem.split("_")[0] for clip in clips])
    limbs = [cmu_limbs(clip) for clip in clips]
    for orders in (2, 3):
        own, high, low = (
            np.array([features(points, fps * factor, orders) for points, fps in limbs])
            for factor in (1.0, CHANGE, 1 / CHANGE)
        )
        for name, changed in (("doubled", high), ("halved", low)):
            right, wrong = scores(own, changed, subjects)
            area = float((wrong[:, None] > right[None]).mean())
            noticed = float((wrong > np.sort(right)[-1 - FALSE]).mean())
            sys.stdout.write(f"{name}, {orders} derivatives: area {area:.3f}, noticed {noticed:.2f}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
