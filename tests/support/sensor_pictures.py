"""Infrared and depth of retro-reflective spheres painted by hand: discs before a wall, noise that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.sensors.devices.device import SensorFrame
from solver_backend.types import Cameras

FULL = 65535
RADIUS_M = 0.007


def sensors_around(count: int = 3, size: tuple[int, int] = (480, 432), radius_m: float = 2.0) -> Cameras:
    """Return sensors on a circle that look at its middle, with a lens that bends."""
    width, height = size
    focal = 0.79 * width
    K = np.array([[focal, 0, (width - 1) / 2 + 1.3], [0, focal, (height - 1) / 2 - 0.7], [0, 0, 1.0]])
    angle = 2 * np.pi * np.arange(count) / count + 0.3
    R, t = [], []
    for a in angle:
        at = np.array([radius_m * np.cos(a), radius_m * np.sin(a), 1.1])
        z = np.array([0, 0, 1.0]) - at
        z /= np.linalg.norm(z)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z])
        R.append(rotation)
        t.append(-rotation @ at)
    names = tuple(f"sensor{k}" for k in range(count))
    bent = np.tile([0.05, -0.03, 0.0004, -0.0003, 0.0], (count, 1))
    return Cameras(names, np.tile(K, (count, 1, 1)), bent, np.array(R), np.array(t), np.tile(size, (count, 1)))


@dataclass(frozen=True)
class Painter:
    """Paints what sensors see of points."""

    cameras: Cameras
    wall_m: float = 3.2
    """Depth of everything that is no marker."""
    depth_sigma_m: float = 0.003
    surface_m: float = 2.0 / 3.0 * RADIUS_M
    """How far before its middle a sphere is measured."""
    fine: int = 8
    background: float = 900.0

    def frame(self, view: int, points: np.ndarray, seed: int = 0, *, time: float = 0.0, number: int = 0) -> SensorFrame:
        """Return what one sensor sees of (N, 3) points."""
        cameras = self.cameras
        width, height = cameras.image_size[view].tolist()
        rng = np.random.default_rng([seed, view])
        infrared = np.full((height, width), self.background)
        depth = np.full((height, width), self.wall_m)
        px = project(cameras, points)[view]
        camera = points @ cameras.R[view].T + cameras.t[view]
        for xy, z, ray in zip(px, camera[:, 2], np.linalg.norm(camera, axis=1), strict=True):
            if not np.isfinite(xy).all():
                continue
            radius = float(cameras.K[view, 0, 0]) * RADIUS_M / z
            window = _around(xy, radius + 3.0, (height, width))
            bright, deep = infrared[window], depth[window]  # views
            cover, ring = (self._disc(window, xy, r) for r in (radius, radius + 3.0))
            bright[:] = np.maximum(bright, np.minimum(6.0 * cover, 1.0) * FULL)
            deep[ring > 0] = z - self.surface_m * z / ray
            deep[bright >= FULL] = 0.0
        infrared = np.clip(infrared + rng.normal(0, 40, infrared.shape), 0, FULL).astype(np.uint16)
        noisy = depth + rng.normal(0, self.depth_sigma_m, depth.shape)
        millimetres = np.where(depth > 0, np.round(1000 * noisy), 0).astype(np.uint16)
        return SensorFrame(cameras.names[view], infrared, millimetres, time, time, number)

    def _disc(self, window: tuple[slice, slice], xy: np.ndarray, radius: float) -> np.ndarray:
        """Return the share of each pixel of a window that a disc covers."""
        steps = (np.arange(self.fine) + 0.5) / self.fine - 0.5
        rows, columns = (np.arange(part.start, part.stop) for part in window)
        x = (columns[:, None] + steps).ravel() - xy[0]
        y = (rows[:, None] + steps).ravel() - xy[1]
        inside = (x**2 + y[:, None] ** 2 <= radius**2).astype(float)
        return inside.reshape(len(rows), self.fine, len(columns), self.fine).mean(axis=(1, 3))


def _around(xy: np.ndarray, radius: float, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a picture that hold a disc; none where it lies outside."""
    ranges = [
        (max(int(at - radius) - 1, 0), min(int(at + radius) + 3, size))
        for at, size in zip(xy, shape[::-1], strict=True)
    ]
    (x0, x1), (y0, y1) = ranges
    return slice(y0, max(y0, y1)), slice(x0, max(x0, x1))


def spread_points(count: int, seed: int = 0, cameras: Cameras | None = None, apart_px: float = 16.0) -> np.ndarray:
    """Return points about (0, 0, 1) that no sensor sees near to one another; (N, 3)."""
    cameras = cameras or sensors_around()
    rng = np.random.default_rng(seed)
    found = np.zeros((0, 3))
    while len(found) < count:
        tried = np.vstack([found, np.array([0, 0, 1.0]) + rng.uniform(-0.5, 0.5, 3)])
        px = project(cameras, tried)
        if len(tried) == 1 or np.linalg.norm(px[:, :-1] - px[:, -1:], axis=-1).min() > apart_px:
            found = tried
    return found
