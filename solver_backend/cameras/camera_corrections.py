"""Correct calibrations made for other image sizes, rotations or conventions.

Corrections change cameras but never detections, so that footage and keypoints stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from solver_backend.exchange.lens import LENS_MODELS
from solver_backend.types import Cameras

FACTORS = (1.0, 1 / 4, 1 / 3, 3 / 8, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 8 / 3, 3.0, 4.0)
"""Possible ratios of the recorded to the calibrated image height: 480, 540, 720, 1080, 1440 or 2160 lines each."""
TURNS = (0, 1, 2, 3)  # Possible numbers of clockwise 90° rotations from the calibrated to the recorded images.
POSES = ("world to camera", "transposed", "camera to world", "places")
"""Possible meanings of the rotation R and vector t in a file: ``x_cam = R x + t`` as in OpenCV, ``x_cam = Rᵀ x + t`` as
with MATLAB's row vectors, ``x = R x_cam + t`` and ``x_cam = R (x - t)``."""
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rotation of the camera axes when an image is rotated clockwise by 90 degrees."""
_GRAPHICS = np.diag([1.0, -1.0, -1.0])
"""Rotation from the camera axes used by OpenGL and Blender (y up, z backward) to OpenCV's (y down, z forward)."""


Window = tuple[float, float, float]
"""Pixel aspect ratio of the recorded images, and how far they extend beyond the left and top edges of the calibrated
images, in image heights. The latter are negative for cropped images and positive for images with bars."""
AS_CALIBRATED: Window = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class CameraCorrection:
    """A possible correction of a calibration, for example for rotated images. The default changes nothing."""

    factor: float = 1.0  # Size of the recorded images relative to the calibrated ones.
    turn: int = 0  # Number of clockwise rotations by 90 degrees from the calibrated to the recorded images.
    pose: str = POSES[0]  # One of ``POSES``.
    graphics: bool = False  # True if the camera axes are those of OpenGL and Blender.
    window: Window = AS_CALIBRATED  # Part of the calibrated images that was recorded, before scaling.

    @property
    def changes(self) -> int:
        """Number of fields that differ from the default correction."""
        return sum(a != b for a, b in zip(astuple(self), astuple(CameraCorrection()), strict=True))

    def meaning(self) -> str:
        """Describe the correction for users, or return an empty text if it changes nothing."""
        parts = [f"the recorded images are {each}" for each in _window_words(self.window)]
        if self.factor != 1.0:
            parts.append(f"the recorded images are {self.factor:.3g} times as large as the calibrated ones")
        if self.turn:
            way = {1: "90° clockwise", 2: "180°", 3: "90° counter-clockwise"}[self.turn]
            parts.append(f"the recorded images are rotated by {way} relative to the calibrated ones")
        if self.pose != POSES[0]:
            meaning = {
                "transposed": "rotations are transposed",
                "camera to world": "rotations and translations are from camera to world",
                "places": "translations are the cameras' positions",
            }
            parts.append(meaning[self.pose])
        if self.graphics:
            parts.append("camera axes are as in OpenGL and Blender")
        return " and ".join(parts)


def _window_words(window: Window) -> list[str]:
    wide = f"{'squeezed' if window[0] < 1 else 'stretched'} to {100 * window[0]:.0f} % of their width"
    words = [wide] if window[0] != AS_CALIBRATED[0] else []
    for far, edge in zip(window[1:], ("at the left", "at the top"), strict=True):
        if round(100 * far):
            what = "cut" if far < 0 else "extended by bars"
            words.append(f"{what} {edge}, by {100 * abs(far):.0f} % of their height")
    return words


def corrected(cameras: Cameras, corrections: list[CameraCorrection]) -> Cameras:
    """Apply one calibration correction per camera, and return the corrected cameras."""
    for c, correction in enumerate(corrections):
        if correction.pose != POSES[0] or correction.graphics:
            cameras = _reposed(cameras, c, correction)
        if correction.window != AS_CALIBRATED:
            cameras = _reshaped(cameras, c, correction.window)
        if correction.factor != 1.0:
            width, height = np.maximum(1, np.round(cameras.image_size[c] * correction.factor)).astype(int).tolist()
            cameras = resized(cameras, c, (width, height))
        for _ in range(correction.turn):
            cameras = _turned_once(cameras, c)
    return cameras


def unrolled(R: np.ndarray, turns: Sequence[int]) -> np.ndarray:
    """Correct the camera rotations R (C, 3, 3) for images that were rotated clockwise.

    ``turns`` is the number of quarter turns of each camera's image.
    """
    once = [np.linalg.matrix_power(QUARTER.T, turn) for turn in turns]
    return np.stack(once) @ R


def resized(cameras: Cameras, index: int, size: tuple[int, int]) -> Cameras:
    """Scale one camera's intrinsics to another image size (width, height) of the same aspect ratio.

    Pixel (0, 0) is a pixel centre, so ``u' + 0.5 = s (u + 0.5)`` px (as in OpenCV's ``resize``).
    """
    K, sizes = cameras.K.copy(), cameras.image_size.copy()
    scale = np.array(size, dtype=np.float64) / sizes[index]
    K[index, :2] *= scale[:, None]
    K[index, :2, 2] += (scale - 1) / 2
    sizes[index] = size
    return replace(cameras, K=K, image_size=sizes)


def _reshaped(cameras: Cameras, c: int, window: Window) -> Cameras:
    """Adapt one camera to the part of its image that was recorded, and to its pixel aspect ratio.

    Pixel u becomes ``u' = s (u + 0.5) + o - 0.5``, where s is the pixel aspect ratio and o shifts the left and top
    edges. The right and bottom edges stay where they are.
    """
    scale, offset = np.array([window[0], 1.0]), cameras.image_size[c, 1] * np.array(window[1:])
    K, sizes = cameras.K.copy(), cameras.image_size.copy()
    K[c, :2] *= scale[:, None]
    K[c, :2, 2] += (scale - 1) / 2 + offset
    sizes[c] = np.maximum(1, np.round(sizes[c] * scale + offset)).astype(sizes.dtype)
    return replace(cameras, K=K, image_size=sizes)


def _reposed(cameras: Cameras, c: int, correction: CameraCorrection) -> Cameras:
    R, t = cameras.R.copy(), cameras.t.copy()
    axes = _GRAPHICS if correction.graphics else np.eye(3)
    world_to_camera = correction.pose in ("world to camera", "places")
    R[c] = axes @ (R[c] if world_to_camera else R[c].T)
    t[c] = axes @ t[c] if correction.pose in ("world to camera", "transposed") else -R[c] @ t[c]
    return replace(cameras, R=R, t=t)


def _turned_once(cameras: Cameras, c: int) -> Cameras:
    """Rotate one camera's image and axes clockwise by 90°: ``u' = h - 1 - v``, ``v' = u`` px, with image height h."""
    K, sizes, R, t = cameras.K.copy(), cameras.image_size.copy(), cameras.R.copy(), cameras.t.copy()
    distortion, height = cameras.distortion.copy(), sizes[c, 1]
    (fx, _, cx), (_, fy, cy) = K[c, 0], K[c, 1]  # no lens has a skew today, which would leave the upper triangle
    K[c] = [[fy, 0.0, height - 1 - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]]
    R[c], t[c], sizes[c] = QUARTER @ R[c], QUARTER @ t[c], sizes[c, ::-1]
    distortion[c] = LENS_MODELS[cameras.models[c]].turn(distortion[c])
    return replace(cameras, K=K, distortion=distortion, R=R, t=t, image_size=sizes)


COMPARED = 16  # Largest number of cameras for which all pairs are compared, if a pair is cheap.


def compared_pairs(count: int, each: int = COMPARED, neighbours: int = 0) -> list[tuple[int, int]]:
    """Choose the camera pairs (i < j) to compare among ``count`` cameras, in ascending order.

    If there are at most ``each`` cameras, all pairs are compared. Otherwise, each camera is compared with the next
    ``neighbours`` cameras (``each - 1`` if 0), and the first camera follows the last one. This connects all cameras,
    and the number of pairs only grows linearly.
    """
    others = range(1, count if count <= each else (neighbours or each - 1) + 1)
    return sorted({(min(c, d), max(c, d)) for c in range(count) for k in others if (d := (c + k) % count) != c})
