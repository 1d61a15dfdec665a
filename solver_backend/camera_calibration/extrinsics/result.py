"""The calibration of cameras with how sure it is and what was found."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.problem import CAMERA_PARAMETERS, Adjusted
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.types import Cameras
from solver_backend.types.shapes import Float


@dataclass(frozen=True)
class CalibratedCameras:
    """Cameras in metres, Z up."""

    cameras: Cameras
    """The result."""
    method: str
    """'board', 'person', 'points', 'refine' or 'together'."""
    rmse_px: float
    """Root mean squared reprojection error."""
    camera_rmse_px: Float[np.ndarray, " cameras"]
    """(C,) of each camera."""
    centre_sigma_m: Float[np.ndarray, " cameras"]
    """(C,) standard deviation of each camera's centre, by the residuals, about the whole array; metres."""
    turn_sigma: Float[np.ndarray, " cameras"]
    """(C,) of its direction, radians."""
    delays_s: Float[np.ndarray, " cameras"]
    """(C,) seconds by which each camera's frames are late."""
    findings: tuple[Diagnostic, ...] = ()
    """What is wrong or odd, with what to do."""
    notes: tuple[Diagnostic, ...] = ()
    """What was done and assumed."""
    lenses: dict[str, dict[str, object]] = field(default_factory=dict)
    """Of each camera: model, held-out error, pictures."""


def result_of(method: str, found: Adjusted, *, measured: bool = False) -> CalibratedCameras:
    """Return the calibration of an adjustment, the covariance scaled to the residuals where noise was not measured.

    A step ``x ← exp(ω) x + τ`` about the camera moves its centre by ``-Rᵀ exp(-ω) τ``.

    Args:
        method: how it was found.
        found: the adjustment.
        measured: the sightings' deviations are those of the residuals already.
    """
    camera_of, noise_px = found.seen.camera, found.seen.sigma
    C = len(found.cameras)
    square = (np.nan_to_num(found.error) ** 2).sum(-1)
    inflation = float(np.median(square / noise_px**2)) / 1.386 if len(square) and not measured else 1.0
    blocks = found.covariance.reshape(C, CAMERA_PARAMETERS, C, CAMERA_PARAMETERS)[range(C), :, range(C)]
    variance = np.einsum("cii->ci", blocks) * max(inflation, 1e-6)
    by_camera = np.array([float(np.sqrt(square[camera_of == c].mean())) if (camera_of == c).any() else np.nan
                          for c in range(C)])  # fmt: skip
    return CalibratedCameras(
        found.cameras, method, found.rmse_px, by_camera, np.sqrt(variance[:, 3:6].sum(-1)),
        np.sqrt(variance[:, :3].sum(-1)), found.delays,
    )  # fmt: skip


def moved_world(calibration: CalibratedCameras, R: np.ndarray, t: np.ndarray, scale: float = 1.0) -> CalibratedCameras:
    """Return the calibration in another world, ``x_new = scale R x_old + t``."""
    cameras = calibration.cameras
    turned = cameras.R @ R.T
    shifted = scale * cameras.t - (turned @ t[:, None])[..., 0]
    return replace(
        calibration, cameras=replace(cameras, R=turned, t=shifted), centre_sigma_m=scale * calibration.centre_sigma_m
    )
