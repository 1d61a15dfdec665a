"""Errors of a hand detector on a real take relative to the palm, from the disagreement of its views.

``python -m tests.benchmarks.hands.real_noise CAPTURE`` uses a capture from ``hands find``. Frames with the hand in
three views are triangulated. The residuals of a view are split into a constant of the view (its camera's error), a
movement of the whole hand, and movements of single points. Jitter follows from second differences.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.io.load import load_capture
from solver_backend.types import Cameras

MEDIAN = 2.0 * float(np.log(2.0))  # Median of a squared length in two dimensions, relative to the variance per axis.


def shares_of(cameras: Cameras, hands: np.ndarray) -> dict[str, float]:
    """Return the deviations per axis of (C, F, 21, 3) detections of one hand in palm lengths, as view means."""
    shown = np.flatnonzero((hands[..., 2] > 0).any(-1).sum(0) >= 3)
    hands = hands[:, shown].astype(float)
    xy, confidence = hands[..., :2], np.nan_to_num(hands[..., 2])
    found = triangulate(cameras, xy, confidence)
    inliers = np.asarray(found.inliers)
    px = project(cameras, np.asarray(found.points))
    left = 1.0 - 3.0 / (2.0 * np.maximum(inliers.sum(axis=0), 2))
    error = np.where(inliers[..., None], xy - px, np.nan) / np.sqrt(left)[None, ..., None]
    reach = np.linalg.norm(xy - xy[:, :, :1], axis=-1)
    palm = np.nanmedian(np.fmax(reach[..., 9], np.nanmax(reach, axis=-1) / 2), axis=1)
    whole = np.where((inliers.sum(-1) >= 8)[..., None], np.nanmean(error, axis=2), np.nan)
    constant = np.nanmedian(whole, axis=1, keepdims=True)
    own = error - np.nanmean(error, axis=2, keepdims=True)
    row = np.diff(shown) == 1
    second = (own[:, 2:] - 2 * own[:, 1:-1] + own[:, :-2])[:, row[1:] & row[:-1]]
    parts = {"constant": constant, "whole": whole - constant, "each point": own, "jitter": second / np.sqrt(6.0)}
    square = {name: (part**2).sum(-1).reshape(len(palm), -1) for name, part in parts.items()}
    return {name: float(np.nanmean(np.sqrt(np.nanmedian(s, axis=1) / MEDIAN) / palm)) for name, s in square.items()}


def main(arguments: list[str]) -> int:
    """Print the shares of each side."""
    capture = load_capture(Path(arguments[0]))
    assert capture.cameras is not None and capture.keypoints is not None and capture.keypoints.hands is not None
    for side, name in enumerate(SIDES):
        shares = shares_of(capture.cameras, capture.keypoints.hands[:, :, side])
        sys.stdout.write(f"{name}: " + ", ".join(f"{part} {share:.3f}" for part, share in shares.items()) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
