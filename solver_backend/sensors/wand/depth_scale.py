"""The scale that pictures of a lone marker do not show: by the depths that sensors measured of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types import Cameras

DEPTH_CONSTANT_M, DEPTH_QUADRATIC = 0.8e-3, 0.55e-3
"""Standard deviation of one pixel's depth at no distance, and what 1 m adds, growing with the square (Tölgyessy et al.
2021, about that of Azure Kinects)."""
SENSOR_BIAS_M = 2e-3
"""How far all depths of one sensor are off together, beyond what is seen here."""
ROUNDS = 20
"""Rounds of reweighting; chosen by hand."""


@dataclass(frozen=True)
class DepthScale:
    """How measured depths compare to those of the pictures."""

    scale: float
    """What the pictures' world is multiplied by."""
    sigma: float
    """Its standard deviation."""
    rmse_m: float
    """Root mean square of what is left, robustly."""


def depth_sigma(depth_m: np.ndarray) -> np.ndarray:
    """Return the standard deviation in metres of depths, ``σ = c + q z²``."""
    return DEPTH_CONSTANT_M + DEPTH_QUADRATIC * depth_m**2


def depth_scale(cameras: Cameras, at: np.ndarray, depth_m: np.ndarray) -> DepthScale:
    """Return the scale ``s`` that minimises ``Σ ρ((d - s z) / σ(d))`` over all sensors, with its deviation.

    Args:
        cameras: C sensors.
        at: (M, 3) metres, the marker in the pictures' world.
        depth_m: (C, M) measured metres along each sensor's axis, NaN where there is none.

    Reference: Beaton and Tukey 1974 (weights that fall with the residual; here Cauchy's).
    """
    z = np.einsum("cj,mj->cm", cameras.R[:, 2], at) + cameras.t[:, 2:]
    known = np.isfinite(depth_m) & np.isfinite(z)
    d, z = np.where(known, depth_m, 1.0), np.where(known, z, 1.0)
    sigma = depth_sigma(d)
    scale = float(np.median((d / z)[known]))
    weight = np.zeros_like(d)
    for _ in range(ROUNDS):
        square = ((d - scale * z) / sigma) ** 2
        weight = known / (1.0 + square / 9.0) / sigma**2
        scale = float((weight * z * d).sum() / (weight * z * z).sum())
    left = np.where(known, d - scale * z, np.nan)
    rmse = float(1.4826 * np.nanmedian(np.abs(left)))
    shared = np.array([(weight[c] * z[c]).sum() for c in range(len(d))]) * SENSOR_BIAS_M
    alone = (weight**2 * z**2 * np.maximum(sigma, rmse) ** 2).sum()
    return DepthScale(scale, float(np.sqrt((shared**2).sum() + alone) / (weight * z * z).sum()), rmse)
