"""SensorSightings of points without pictures: what sensors would tell, with noise of the covariance that they tell."""

from __future__ import annotations

import numpy as np

from solver_backend.sensors.acquisition.acquire import SensorLens, SensorSightings
from solver_backend.types import Cameras

_LENSES: dict[tuple[int, int], SensorLens] = {}
SIGMA_PX, SIGMA_DEPTH_M = 0.15, 0.002


def sighted(
    cameras: Cameras, sensor: int, points: np.ndarray, *, time: float = 0.0, rays: tuple[int, ...] = (), seed: int = 0,
    host_s: float | None = None,
) -> SensorSightings:  # fmt: skip
    """Return what a sensor tells of (N, 3) points; those of ``rays`` without depth."""
    rng = np.random.default_rng([seed, sensor])
    if (id(cameras), sensor) not in _LENSES:
        _LENSES[id(cameras), sensor] = SensorLens(cameras, sensor)
    lens = _LENSES[id(cameras), sensor]
    camera = points @ lens.R.T + lens.t
    flat, depth = camera[:, :2] / camera[:, 2:], camera[:, 2].copy()
    flat = flat + rng.normal(0, SIGMA_PX, flat.shape) / lens.focal
    depth = depth + rng.normal(0, SIGMA_DEPTH_M, len(depth))
    depth[list(rays)] = np.nan
    sigma = np.full(len(points), SIGMA_PX)
    covariance = lens.covariances(flat, depth, sigma, np.full(len(points), SIGMA_DEPTH_M))
    return SensorSightings(
        sensor, time, np.zeros((len(points), 2)), depth, lens.points(flat, depth), covariance, lens.centre,
        lens.directions(flat), sigma / lens.focal.mean(), host_s=time if host_s is None else host_s,
    )  # fmt: skip
