"""Views through calibrated cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .._exchange.capture_file import CameraFile
from .._exchange.lens import normalised, pixels, undistort
from ..conventions.skeleton import JOINTS

BODY_REACH_M = np.array([0.26 if joint == "head" else 0.2 for joint in JOINTS])
"""(24,) largest distance in metres between each joint and the skin around it."""

_CLOSEST = 0.5  # Smallest fraction of a camera's image that a view shows.


@dataclass(frozen=True)
class View:
    """A camera's image, or a part of it, shown in a picture of ``size`` pixels."""

    camera: CameraFile
    size: tuple[int, int]  # Width and height of the picture.
    part: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Left and top edges of the part in camera pixels, and its size as a fraction of the image."""

    @property
    def scale(self) -> np.ndarray:
        """Number of picture pixels per camera pixel along x and y, shape (2,)."""
        return np.array(self.size) / np.array(self.camera.image_size) / self.part[2]

    @property
    def K(self) -> np.ndarray:
        """Intrinsic matrix (3, 3) of the picture in pixels."""
        K = self.camera.K.copy()
        K[0, :2] *= self.scale[0]
        K[1, 1] *= self.scale[1]
        K[:2, 2] = (self.camera.K[:2, 2] + 0.5 - self.part[:2]) * self.scale - 0.5
        return K

    @property
    def pinhole(self) -> CameraFile:
        """A camera that takes this picture, without distortion or footage."""
        return replace(self.camera, K=self.K, image_size=self.size, distortion=np.zeros(8), footage=None)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points to picture pixels (..., 2), NaN behind the camera, and depths (...) in metres."""
        p = points @ self.camera.R.T + self.camera.t
        depth = p[..., 2]
        safe = np.where(depth > 1e-3, depth, np.nan)[..., None]
        return pixels(p[..., :2] / safe, self.K), depth

    def from_detections(self, xy: np.ndarray) -> np.ndarray:
        """Convert (..., 2) distorted camera pixels to pixels of the undistorted picture."""
        straight = undistort(normalised(xy, self.camera.K), self.camera.distortion, self.camera.distortion_model)
        return pixels(straight, self.K)

    def window(self, joints: np.ndarray) -> tuple[int, int, int, int] | None:
        """Return the part (x0, y0, x1, y1) of the picture that the body may cover, or None if it is not visible."""
        uv, depth = self.project(joints)
        if (depth < 2 * BODY_REACH_M).any():
            return (0, 0, *self.size) if (depth > 0).any() else None
        reach = np.array([self.K[0, 0], self.K[1, 1]]) * (BODY_REACH_M / depth)[:, None]
        low = np.floor((uv - reach).min(axis=0)).astype(int)
        high = np.ceil((uv + reach).max(axis=0)).astype(int)
        x0, y0 = max(low[0], 0), max(low[1], 0)
        x1, y1 = min(high[0], self.size[0]), min(high[1], self.size[1])
        return (int(x0), int(y0), int(x1), int(y1)) if x1 > x0 and y1 > y0 else None


def close_view(camera: CameraFile, joints: np.ndarray, size: tuple[int, int]) -> View:
    """Return a view of the image part that shows the joints (F, 24, 3), enlarged by a factor of at most 2."""
    whole, image = View(camera, camera.image_size), np.array(camera.image_size, dtype=np.float64)
    windows = [window for frame in joints if (window := whole.window(frame)) is not None]
    if not windows:
        return View(camera, size)
    low = np.min([window[:2] for window in windows], axis=0)
    high = np.max([window[2:] for window in windows], axis=0)
    share = float(np.clip(((high - low) / image).max(), _CLOSEST, 1.0))
    corner = np.clip((low + high) / 2 - share * image / 2, 0, (1 - share) * image)
    return View(camera, size, (float(corner[0]), float(corner[1]), share))


def look_at(
    name: str, centre: np.ndarray, target: np.ndarray, size: tuple[int, int], field_of_view: float
) -> CameraFile:
    """Return a camera at ``centre`` that looks at ``target`` (in metres). The image is level, with z up."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    focal = size[1] / 2 / np.tan(field_of_view / 2)
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])
    return CameraFile(name, K, R, -R @ centre, size, np.zeros(8), "opencv", None)


def three_quarter_view(
    points: np.ndarray, heading: float, size: tuple[int, int], *, margin_m: float = 0.2
) -> CameraFile:
    """Return a camera in front and to the left of a body, with all (N, 3) points in its picture.

    In camera axes from the points' centre (x right, y up, z towards the camera), a point is in the picture if the
    camera's distance is at least ``z + max(|x| / tan(a / 2), |y| / tan(b / 2))``. The fields of view are a and b.
    ``margin_m`` is added to |x| and |y|.
    """
    field_of_view, elevation, angle = np.radians(32.0), np.radians(14.0), heading + np.radians(38.0)
    away = np.array([np.cos(angle) * np.cos(elevation), np.sin(angle) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.sin(angle), np.cos(angle), 0.0])
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    x, y, z = (
        np.abs((points - target) @ right),
        np.abs((points - target) @ np.cross(away, right)),
        (points - target) @ away,
    )
    up = np.tan(field_of_view / 2)
    across = up * size[0] / size[1]
    distance = (z + np.maximum((x + margin_m) / across, (y + margin_m) / up)).max()
    return look_at("front and left", target + away * distance, target, size, float(field_of_view))
