"""Whether all focal lengths are off alike: by the factor under which the views agree best.

A zoom that moved, or a mode of the cameras that crops, makes every focal length wrong by one factor. The views still
nearly agree, on somebody of another size elsewhere. What shows it is that they agree better with other focal lengths.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from solver_backend.cameras.projection import undistort
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.types import Cameras, Keypoints2D

FACTORS = np.geomspace(0.6, 1 / 0.6, 21)
"""Times the calibrated focal lengths, in steps of 5 %; neither end is a finding."""
_LOOKED_AT = (0.72, 0.85, 1.18, 1.4)
"""Factors of which one must be better than 1 for the others to be tried."""
OFF, BETTER = 0.15, 1.08
"""Logarithm of a factor, and how many times nearer the views must come with it, that are a finding. Detections leave 1
open by 0.1 at most, and gain 1.05 by that, in the demo, in simulated takes and in recorded ones; where all lenses are
calibrated 25 % too long, 1.12."""
LEAST_CAMERAS = 3
"""Two views agree by chance in too many ways."""
MOST_CAMERAS, FRAMES = 8, 40
"""Cameras and frames that are compared, of more."""
SEEN = 0.3
"""Confidence from which a keypoint counts."""


def report_focal_lengths(cameras: Cameras, keypoints: Keypoints2D) -> tuple[Diagnostic, ...]:
    """Return the warning that all focal lengths seem too long or too short, () where the views do not clearly show it.

    Args:
        cameras: C cameras in any unit.
        keypoints: of one person in the same views.
    """
    if len(cameras) < LEAST_CAMERAS or not keypoints.num_frames:
        return ()
    chosen = np.unique(np.linspace(0, len(cameras) - 1, MOST_CAMERAS).astype(int))
    frames = np.unique(np.linspace(0, keypoints.num_frames - 1, FRAMES).astype(int))
    few = cameras.subset(chosen.tolist())
    seen = keypoints.confidence[chosen][:, frames] >= SEEN
    xy = np.where(seen[..., None], keypoints.xy[chosen][:, frames].astype(np.float64), np.nan)
    # Keypoints are two witnesses: what one half shows and the other does not is chance.
    factors, gains = zip(*(_best(few, xy[:, :, part::2]) for part in (0, 1)), strict=True)
    logs = np.log(factors)
    if np.abs(logs).min() < OFF or logs[0] * logs[1] < 0 or min(gains) < BETTER:
        return ()
    factor = float(np.exp(logs.mean()))
    way = "short" if factor > 1 else "long"
    percent = 100 * abs(1 / factor - 1)
    return (diagnostic("focal_lengths_off", cameras=cameras.names, percent=percent, way=way),)


def _best(cameras: Cameras, xy: np.ndarray) -> tuple[float, float]:
    """Return the factor of the focal lengths by which views (C, F, J, 2) px agree best, and how many times nearer."""
    as_calibrated = _distance(cameras, xy, 1.0)
    if not any(_distance(cameras, xy, factor) < as_calibrated for factor in _LOOKED_AT):
        return 1.0, 1.0
    off = np.array([as_calibrated, *(_distance(cameras, xy, factor) for factor in FACTORS)])
    if not np.isfinite(off).all() or (best := int(off[1:].argmin())) in (0, len(FACTORS) - 1):
        return 1.0, 1.0
    return float(FACTORS[best]), float(off[0] / off[1 + best])


def _distance(cameras: Cameras, xy: np.ndarray, factor: float) -> float:
    """Return the median distance of points from each other's epipolar lines, px, focal lengths times a factor.

    Reference: Hartley and Zisserman 2004, eq. 11.9 (Sampson's distance).
    """
    K = cameras.K.copy()
    K[:, [0, 1], [0, 1]] *= factor
    n = undistort(K, cameras.distortion, xy, cameras.distortion_model)
    seen = np.concatenate([n, np.ones_like(n[..., :1])], axis=-1)
    distances = np.concatenate(list(_pairs(replace(cameras, K=K), seen)))
    return float(np.median(distances)) if len(distances) else float("nan")


def _pairs(cameras: Cameras, seen: np.ndarray) -> Iterator[np.ndarray]:
    for i, j in combinations(range(len(cameras)), 2):
        both = np.isfinite(seen[i]).all(-1) & np.isfinite(seen[j]).all(-1)
        R = cameras.R[j] @ cameras.R[i].T
        x, y, z = cameras.t[j] - R @ cameras.t[i]
        E = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
        one, other = seen[i][both], seen[j][both]
        line, back = one @ E.T, other @ E
        slope = np.sqrt((line[:, :2] ** 2).sum(-1) + (back[:, :2] ** 2).sum(-1))
        focal = 0.25 * (np.trace(cameras.K[i, :2, :2]) + np.trace(cameras.K[j, :2, :2]))
        yield focal * np.abs((other * line).sum(-1)) / np.maximum(slope, 1e-12)
