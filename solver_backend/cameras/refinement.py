"""Camera poses corrected by the person they film: points located by all views, then every camera by the points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.cameras.projection import project_with_jacobian
from solver_backend.cameras.triangulation.triangulate import triangulate
from solver_backend.geometry.rotations import exp_so3, skew
from solver_backend.types import Cameras

FRAMES = 60
"""Frames at most that cameras are corrected by, spread over the take."""
_LEAST_EIGENVALUE = 1e-12
"""Of a camera's equations over the largest, below which its direction is open; chosen by hand, above rounding."""


def refined_cameras(cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, rounds: int = 6) -> Cameras:
    """Return the cameras with poses that fit the detections of one person better: alternating bundle adjustment.

    The world frame is kept only as far as the given poses agree on it.

    Args:
        cameras: C calibrated cameras.
        xy: (C, F, K, 2) px, NaN where missing.
        confidence: (C, F, K), 0 where missing.
        rounds: of triangulation and resection.

    Raises:
        TooFewViews, CalibrationMismatch, KeypointCountMismatch: see ``triangulate``.

    Reference: Triggs et al. 2000, "Bundle adjustment: a modern synthesis", sec. 7 (resection-intersection).
    """
    sample = np.unique(np.linspace(0, xy.shape[1] - 1, min(FRAMES, xy.shape[1])).astype(int))
    xy, confidence = xy[:, sample], confidence[:, sample]
    for _ in range(rounds):
        located = triangulate(cameras, xy, confidence)
        spread = float(np.nanmedian(located.sigma_px))
        cameras = resected(cameras, xy, confidence, located.points, 2.0 * spread)
    return cameras


def resected(
    cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, points: np.ndarray, scale_px: float, steps: int = 5
) -> Cameras:
    """Return the cameras with poses fitted to known points: Gauss-Newton on ``Σ c ρ(r / scale)``, ρ of Geman-McClure.

    A camera is moved by ``x_cam ← exp(ω) x_cam + τ``, so ``dx_cam = -[x_cam]x ω + τ``.

    Args:
        cameras: C cameras near the solution.
        xy: (C, F, K, 2) px, NaN where missing.
        confidence: (C, F, K), 0 where missing.
        points: (F, K, 3) world metres, NaN where unknown.
        scale_px: residual at which a detection starts to lose weight.
        steps: Gauss-Newton steps.

    Reference: Geman and McClure 1987 (the penalty); Triggs et al. 2000, sec. 7 (resection).
    """
    count = len(cameras)
    flat, target = points.reshape(-1, 3), xy.reshape(count, -1, 2)
    for _ in range(steps):
        px, J, _ = project_with_jacobian(
            cameras.K, cameras.distortion, cameras.R, cameras.t, flat, cameras.distortion_model
        )
        error = target - px
        usable = np.isfinite(error).all(-1)
        error = np.where(usable[..., None], error, 0.0)
        weight = confidence.reshape(count, -1) * usable / (1.0 + (error**2).sum(-1) / scale_px**2) ** 2
        in_camera = np.nan_to_num(flat @ cameras.R.swapaxes(-1, -2) + cameras.t[:, None])
        by_point = np.nan_to_num(J) @ cameras.R.swapaxes(-1, -2)[:, None]
        by_pose = np.concatenate([-by_point @ skew(in_camera), by_point], axis=-1)
        weighted = by_pose * weight[..., None, None]
        normal = np.einsum("cnia,cnib->cab", weighted, by_pose) + 1e-9 * np.eye(6)
        step = _solved(normal, np.einsum("cnia,cni->ca", weighted, error)[..., None])[..., 0]
        rotation = exp_so3(step[:, :3])
        t = (rotation @ cameras.t[..., None])[..., 0] + step[:, 3:]
        cameras = replace(cameras, R=rotation @ cameras.R, t=t)
    return cameras


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the (C, 6, 1) steps; the shortest where a camera's points leave its pose open, as one place alone does."""
    try:
        return np.linalg.solve(normal, right)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(normal, rcond=_LEAST_EIGENVALUE, hermitian=True) @ right
