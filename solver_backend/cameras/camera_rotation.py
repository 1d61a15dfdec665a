"""How far a camera was rotated about its own centre, and its detections as it would have seen them before."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import project, project_with_jacobian, undistort
from solver_backend.geometry.rotations import exp_so3, log_so3, skew
from solver_backend.types import Cameras
from solver_backend.types.shapes import Float

SCALES = (300.0, 100.0, 30.0, 10.0, 3.0, 3.0)
"""Scales of Geman and McClure's weights, in standard deviations: from plain least squares to robust."""
STEPS = 3
"""Gauss-Newton steps at each scale."""


def estimated_rotation(
    camera: Cameras,
    points: Float[np.ndarray, "points 3"],
    px: Float[np.ndarray, "points 2"],
    sigma_px: Float[np.ndarray, " points"],
) -> Float[np.ndarray, " 3"]:
    """Return the rotation vector (3,) ω in radians, camera axes, whose ``R_now = exp(ω) R`` brings points to pixels.

    Gauss-Newton on ``Σ ρ(|π(exp(ω) (R X + t)) - x| / σ)``, with graduated non-convexity.

    Args:
        camera: one camera as it was calibrated.
        points: (N, 3) world metres.
        px: (N, 2) where it sees them.
        sigma_px: (N,) standard deviations, px.

    Reference: Geman and McClure 1987 (the penalty); Blake and Zisserman 1987 (graduated non-convexity).
    """
    R, t = camera.R[0].copy(), camera.t[0].copy()
    for scale in SCALES:
        for _ in range(STEPS):
            expected, J, _ = project_with_jacobian(
                camera.K, camera.distortion, R[None], t[None], points, camera.distortion_model
            )
            error = (px - expected[0]) / sigma_px[:, None]
            local = points @ R.T + t
            by_rotation = -(J[0] @ R.T) @ skew(local) / sigma_px[:, None, None]
            known = np.isfinite(error).all(-1)
            weight = np.where(known, (scale**2 / (scale**2 + np.nan_to_num(error**2).sum(-1))) ** 2, 0.0)
            A = by_rotation[known]
            weighted = np.swapaxes(A, -1, -2) * weight[known, None, None]
            normal = (weighted @ A).sum(axis=0) + 1e-9 * np.eye(3)
            step = exp_so3(np.linalg.solve(normal, (weighted @ error[known, :, None]).sum(axis=0)[:, 0]))
            R, t = step @ R, step @ t
    return log_so3(R @ camera.R[0].T)


def rotated_back(
    camera: Cameras, px: Float[np.ndarray, "*batch 2"], rotation: Float[np.ndarray, "*turns 3"]
) -> Float[np.ndarray, "*batch 2"]:
    """Return pixels (..., 2) as the camera would have seen them before it was rotated by ``exp(rotation)``.

    The centre stays, so that every ray is only rotated: ``d = exp(ω)ᵀ d_now``.

    Args:
        camera: one camera as it was calibrated.
        px: (..., 2) pixels as the rotated camera saw them.
        rotation: (3,) radians, see ``estimated_rotation``; (F, 3) for (F, n, 2) pixels.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 8.4 (cameras with one centre).
    """
    n = undistort(camera.K, camera.distortion, px[None], camera.distortion_model)[0]
    rays = np.concatenate([n, np.ones_like(n[..., :1])], axis=-1) @ exp_so3(rotation)
    return project(camera.K, camera.distortion, np.eye(3)[None], np.zeros((1, 3)), rays, camera.distortion_model)[0]
