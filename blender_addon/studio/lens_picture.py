"""Pictures through a bent lens: Blender renders a wider pinhole, and each pixel is read where its ray runs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .._exchange.capture_file import CameraFile
from .._exchange.lens import normalised, pixels, undistort
from ..render.resampling import Resampling

_WIDEST = 1.6
"""Times as wide and high as the picture that the pinhole's may be."""
_OUTSIDE = (0, 0, 0)


@dataclass(frozen=True)
class LensPicture:
    """A camera as Blender can render it, and the map from there to its own pixels."""

    pinhole: CameraFile
    """What is rendered: no distortion, the same focal length."""
    resampling: Resampling | None
    """None where the pinhole's picture is the camera's own."""

    def __call__(self, rendered: np.ndarray) -> np.ndarray:
        """Return the camera's (h, w, 3) picture of the pinhole's."""
        return rendered if self.resampling is None else self.resampling(np.ascontiguousarray(rendered))


def lens_picture(camera: CameraFile) -> LensPicture:
    """Return how a camera's pictures are rendered."""
    straight = replace(camera, distortion=np.zeros(8), distortion_model="opencv", footage=None)
    if not camera.distortion.any() and camera.distortion_model == "opencv":
        return LensPicture(straight, None)
    width, height = camera.image_size
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    flat = undistort(normalised(np.stack([u, v], -1), camera.K), camera.distortion, camera.distortion_model)
    seen = pixels(flat, camera.K)
    low = np.floor(np.nanmin(seen.reshape(-1, 2), axis=0)) - 1
    high = np.ceil(np.nanmax(seen.reshape(-1, 2), axis=0)) + 1
    spare = (_WIDEST - 1) / 2 * np.array([width, height])
    low, high = np.maximum(low, -spare.round()), np.minimum(high, np.array([width, height]) + spare.round())
    K = camera.K.copy()
    K[:2, 2] -= low
    size = (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1)
    positions = np.nan_to_num(seen - low, nan=-1e6)
    return LensPicture(replace(straight, K=K, image_size=size), Resampling(positions, size, _OUTSIDE))
