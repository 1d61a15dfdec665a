"""A sensor's lens and place: rays of pixels by a table, points of pixels with depths, and how sure they are."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.cameras.projection import undistort
from solver_backend.types import Cameras


class SensorLens:
    """One camera of a calibration, with the undistorted coordinates of every pixel at hand.

    Args:
        cameras: the calibration.
        index: which camera of it.
    """

    def __init__(self, cameras: Cameras, index: int) -> None:
        one = cameras.subset([index])
        self.name = one.names[0]
        self.size = (int(one.image_size[0, 0]), int(one.image_size[0, 1]))
        self.R, self.t = one.R[0], one.t[0]
        self.centre = one.centres[0]
        self.focal = np.array([one.K[0, 0, 0], one.K[0, 1, 1]])
        self._table = _undistorted_pixels(one.K.tobytes(), one.distortion.tobytes(), self.size, one.models[0])

    def undistorted(self, px: np.ndarray) -> np.ndarray:
        """Return (N, 2) x/z and y/z of (N, 2) pixels, between four entries of the table; NaN outside the picture."""
        width, height = self.size
        at = px + 1.0
        with np.errstate(invalid="ignore"):
            inside = (at >= 0.0).all(1) & (at <= np.array([width + 1.0, height + 1.0])).all(1)
        at = np.where(inside[:, None], at, 0.0)
        corner = np.minimum(at.astype(np.int64), np.array([width, height]))
        x, y = corner.T
        a, b = (at - corner).T[..., None]
        rows = self._table
        found = (1 - b) * ((1 - a) * rows[y, x] + a * rows[y, x + 1]) + b * (
            (1 - a) * rows[y + 1, x] + a * rows[y + 1, x + 1]
        )
        return np.where(inside[:, None], found, np.nan)

    def directions(self, flat: np.ndarray) -> np.ndarray:
        """Return (N, 3) unit directions in the world of (N, 2) undistorted coordinates."""
        ray = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return (ray / np.linalg.norm(ray, axis=1, keepdims=True)) @ self.R

    def points(self, flat: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return (N, 3) world points of undistorted coordinates and (N,) depths along the axis in metres."""
        ray = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return (ray * depth[:, None] - self.t) @ self.R

    def covariances(
        self, flat: np.ndarray, depth: np.ndarray, sigma_px: np.ndarray, sigma_depth: np.ndarray
    ) -> np.ndarray:
        """Return (N, 3, 3) m² in the world: ``J diag(σ_u², σ_v², σ_z²) Jᵀ`` of ``p = z (x, y, 1)``.

        Args:
            flat: (N, 2) undistorted coordinates.
            depth: (N,) metres.
            sigma_px: (N,) px, of both axes.
            sigma_depth: (N,) metres.
        """
        J = np.zeros((len(depth), 3, 3))
        J[:, 0, 0] = depth / self.focal[0] * sigma_px
        J[:, 1, 1] = depth / self.focal[1] * sigma_px
        J[:, :2, 2] = flat * sigma_depth[:, None]
        J[:, 2, 2] = sigma_depth
        turned = self.R.T @ J
        return turned @ np.swapaxes(turned, 1, 2)


@lru_cache(maxsize=8)
def _undistorted_pixels(K: bytes, distortion: bytes, size: tuple[int, int], model: str) -> np.ndarray:
    """Return (h + 2, w + 2, 2) of a lens given as bytes, a second of work for four sensors; it must not be written to.

    One pixel more on each side, so that every point of the picture lies between four of the table.
    """
    width, height = size
    u, v = np.meshgrid(np.arange(-1.0, width + 1.0), np.arange(-1.0, height + 1.0))
    lens = Lens(np.frombuffer(K).reshape(3, 3), np.frombuffer(distortion), size, model)
    table = undistort(lens.as_camera(), np.stack([u, v], axis=-1)[None])[0]
    table.flags.writeable = False
    return table
