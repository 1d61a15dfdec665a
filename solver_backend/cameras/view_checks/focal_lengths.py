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
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras, Keypoints2D

OFF = 0.05
"""Logarithm of a factor from which it is a finding."""
SIGMAS = 3.5
"""Standard deviations from which it is: right lenses reach 2.5 in ten simulated takes, the demo and recorded takes;
those of nine in ten simulated takes that are calibrated 10 % too long, 3.9."""
FACTOR_SPREAD = 0.3
"""Of the logarithm, before anything is seen."""
TURN_SPREAD_RAD, LARGEST_TURN_RAD = 0.005, 0.015
"""How far calibrated cameras are turned from the true ones; beyond the second they are not what lenses explain."""
OFF_PERSON = 0.006
"""Least spread of detections by the person's extent in the picture, for those of somebody who stands still."""
MOMENTS = 6
"""Moments of a take between which errors of detections are independent; chosen so that ten simulated takes spread as
far as their standard deviations state."""
LARGEST_LOG = 0.7
ROUNDS, CONVERGED = 12, 1e-3
LEAST_CAMERAS = 3
"""Two views agree by chance in too many ways."""
MOST_CAMERAS, FRAMES = 8, 24
"""Cameras and frames that are compared, of more."""
SEEN = 0.3
"""Confidence from which a keypoint counts."""
_STEP = 1e-4
"""Of the finite differences, a logarithm or rad."""


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
    seen = keypoints.confidence[chosen][:, frames] >= SEEN
    xy = np.where(seen[..., None], keypoints.xy[chosen][:, frames].astype(np.float64), np.nan)
    log, sigma = focal_factor(cameras.subset(chosen.tolist()), xy)
    if abs(log) < OFF or abs(log) < SIGMAS * sigma:
        return ()
    way, percent = "short" if log > 0 else "long", 100 * abs(np.exp(-log) - 1)
    return (diagnostic("focal_lengths_off", cameras=cameras.names, percent=percent, way=way),)


def focal_factor(cameras: Cameras, xy: np.ndarray) -> tuple[float, float]:
    """Return the logarithm of the factor by which focal lengths are too short, and its standard deviation.

    Least squares of the distances from epipolar lines with Cauchy's weights; every camera may be turned a little, or
    calibrations that are a little off would count as evidence. (0, infinity) where nothing is known.

    Args:
        cameras: C cameras in any unit.
        xy: (C, F, J, 2) px of one person, NaN where unseen.
    """
    unknowns = 1 + 3 * len(cameras)
    spread = np.r_[FACTOR_SPREAD, np.full(unknowns - 1, TURN_SPREAD_RAD)]
    least = OFF_PERSON * _extent(xy)
    x = np.zeros(unknowns)
    for _ in range(ROUNDS):
        seen, longer = (_rays(cameras, xy, log) for log in (x[0], x[0] + _STEP))
        off = _distances(cameras, seen, x)
        if not len(off):
            break
        moved = [
            _distances(cameras, longer if n == 0 else seen, x + _STEP * np.eye(unknowns)[n]) for n in range(unknowns)
        ]
        J = (np.stack(moved, axis=-1) - off[:, None]) / _STEP
        sigma = max(1.4826 * float(np.median(np.abs(off))), least)
        weight = min(1.0, MOMENTS / xy.shape[1]) / sigma**2 / (1.0 + (off / (2.0 * sigma)) ** 2)
        information = (J * weight[:, None]).T @ J + np.diag(spread**-2.0)
        step = -np.linalg.solve(information, J.T @ (weight * off) + x / spread**2)
        x = x + step
        if abs(x[0]) > LARGEST_LOG:
            break
        if abs(step[0]) < CONVERGED:
            known = np.abs(x[1:]).max() < LARGEST_TURN_RAD
            return (float(x[0]), float(np.sqrt(np.linalg.inv(information)[0, 0]))) if known else (0.0, np.inf)
    return 0.0, np.inf


def _extent(xy: np.ndarray) -> float:
    """Return the median diagonal of the person in a picture, px; 0 where nobody is seen."""
    some = np.isfinite(xy).all(-1).any(-1)
    if not some.any():
        return 0.0
    people = xy[some]
    return float(np.median(np.linalg.norm(np.nanmax(people, axis=1) - np.nanmin(people, axis=1), axis=-1)))


def _rays(cameras: Cameras, xy: np.ndarray, log: float) -> np.ndarray:
    """Return (C, F, J, 3) directions (x, y, 1) of pixels in lenses that are longer by a logarithm."""
    n = undistort(_lengthened(cameras.K, log), cameras.distortion, xy, cameras.distortion_model)
    return np.concatenate([n, np.ones_like(n[..., :1])], axis=-1)


def _lengthened(K: np.ndarray, log: float) -> np.ndarray:
    longer = K.copy()
    longer[:, :2, :2] *= np.exp(log)
    return longer


def _distances(cameras: Cameras, seen: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return signed distances of points from each other's epipolar lines, px.

    Args:
        cameras: C cameras.
        seen: (C, F, J, 3) directions, NaN where unseen.
        x: (1 + 3 C,) logarithm of the focal lengths' factor; turns of the cameras, rad.

    Reference: Hartley and Zisserman 2004, eq. 11.9 (Sampson's distance).
    """
    turn = exp_so3(x[1:].reshape(-1, 3))
    turned = replace(cameras, R=turn @ cameras.R, t=(turn @ cameras.t[..., None])[..., 0])
    return np.concatenate(list(_pairs(turned, seen, np.exp(x[0]))))


def _pairs(cameras: Cameras, seen: np.ndarray, factor: float) -> Iterator[np.ndarray]:
    for i, j in combinations(range(len(cameras)), 2):
        both = np.isfinite(seen[i]).all(-1) & np.isfinite(seen[j]).all(-1)
        R = cameras.R[j] @ cameras.R[i].T
        x, y, z = cameras.t[j] - R @ cameras.t[i]
        E = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
        one, other = seen[i][both], seen[j][both]
        line, back = one @ E.T, other @ E
        slope = np.sqrt((line[:, :2] ** 2).sum(-1) + (back[:, :2] ** 2).sum(-1))
        focal = 0.25 * factor * (np.trace(cameras.K[i, :2, :2]) + np.trace(cameras.K[j, :2, :2]))
        yield focal * (other * line).sum(-1) / np.maximum(slope, 1e-12)
