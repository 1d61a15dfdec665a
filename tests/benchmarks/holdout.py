"""Measure the prediction of a held-out camera, a test that needs no ground truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.evaluation.evaluate import triangulate_and_filter
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.types import Cameras, Capture


@dataclass(frozen=True)
class HeldOut:
    """Distance between a camera's detections and their prediction from the other cameras."""

    cameras: tuple[str, ...]  # Names of the cameras, each held out once.
    solver_px: np.ndarray  # (C,) median error of the solve.
    baseline_px: np.ndarray  # (C,) median error of triangulation and Butterworth filter.
    pooled_px: tuple[float, float]  # Median over all detections of all cameras: solve, baseline.


def leave_one_camera_out(
    capture: Capture,
    settings: SolveSettings = SolveSettings(),
    report: Callable[[str], None] = lambda line: None,
) -> HeldOut:
    """Solve without each camera in turn and predict it. Both methods are evaluated on the same detections.

    Raises:
        TooFewViews: the capture has fewer than three cameras, so none can be left out.
    """
    cameras, keypoints = capture.require_multiview()
    ours, theirs = [], []
    for c, name in enumerate(cameras.names):
        others = [i for i in range(len(cameras)) if i != c]
        rest = capture.views(others)
        motion = solve(rest, settings).motion
        assert rest.cameras is not None and rest.keypoints is not None and motion.keypoints3d is not None
        baseline = triangulate_and_filter(rest.cameras, rest.keypoints)
        observed = keypoints.xy[c]
        errors = [_error(cameras.subset([c]), points, observed) for points in (motion.keypoints3d, baseline)]
        both = np.isfinite(errors[0]) & np.isfinite(errors[1])
        ours.append(errors[0][both])
        theirs.append(errors[1][both])
        report(
            f"{name}: solve {np.median(ours[-1]):.2f} px, triangulation + Butterworth {np.median(theirs[-1]):.2f} px"
        )
    pooled = float(np.median(np.concatenate(ours))), float(np.median(np.concatenate(theirs)))
    medians = [np.array([np.median(e) for e in side]) for side in (ours, theirs)]
    return HeldOut(cameras.names, medians[0], medians[1], pooled)


def _error(camera: Cameras, points: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Return (F, K) pixel distances of projected points to one camera's detections."""
    px = project(camera, points)[0]
    return np.linalg.norm(px - observed, axis=-1)
