"""Convert coordinate frames and lenses between the solver's and Blender's conventions.

Both use metres and a world with Z up. They differ in two respects. The body's rest frame is SMPL's (Y up, facing +Z,
left = +X), and becomes an armature in Blender's frame (Z up, facing -Y, left = +X). Cameras are OpenCV's (x right, y
down, looking along +z, the centre of the top-left pixel at (0, 0)), and become Blender's (x right, y up, looking along
-z, image coordinates from 0 to 1 starting at the bottom left).

Blender's cameras have no lens distortion and no skew, so they show the undistorted image.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import bpy
import numpy as np

R_ARMATURE_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from the body's rest frame to the armature's frame: +90° about X."""

QUAT_BODY_ARMATURE = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])
"""Inverse of ``R_ARMATURE_BODY`` as a quaternion (wxyz): -90° about X."""

SENSOR_WIDTH_MM = 36.0  # Nominal sensor width. Only its ratio to the focal length matters.

_EVEN = 1e-3  # Relative difference between scales that is ignored.
_FLIP_YZ = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class BlenderLens:
    """A pinhole lens in Blender's parameters, for ``sensor_fit = 'HORIZONTAL'``."""

    focal_mm: float  # Focal length for a sensor of ``SENSOR_WIDTH_MM``.
    shift_x: float  # Distance of the principal point to the left of the image centre, in image widths.
    shift_y: float  # Distance of the principal point below the image centre, in image widths of square pixels.
    pixel_aspect: tuple[float, float]  # Pixel aspect x and y of the scene, both at least 1.


def lens_from_intrinsics(K: np.ndarray, image_size: tuple[int, int]) -> BlenderLens:
    """Convert an OpenCV intrinsic matrix to Blender's lens parameters.

    For width w, height h and a = fx / fy: ``focal = 36 fx / w``, ``shift_x = (w/2 - cx - 1/2) / w``, ``shift_y = a (cy
    + 1/2 - h/2) / w`` and the pixel aspect is 1 : a. The halves appear because OpenCV measures from a pixel's centre
    and Blender from its edge. Skew is ignored.

    Args:
        K: (3, 3) intrinsic matrix in pixels.
        image_size: width and height in pixels.
    """
    width, height = image_size
    aspect = K[0, 0] / K[1, 1]
    return BlenderLens(
        focal_mm=float(SENSOR_WIDTH_MM * K[0, 0] / width),
        shift_x=float((width / 2 - K[0, 2] - 0.5) / width),
        shift_y=float(aspect * (K[1, 2] + 0.5 - height / 2) / width),
        pixel_aspect=(float(max(1.0, 1.0 / aspect)), float(max(1.0, aspect))),
    )


def camera_to_world(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return a Blender camera's ``matrix_world`` (4, 4), given ``x_cam = R @ x_world + t`` in metres."""
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = R.T @ _FLIP_YZ
    T_world_camera[:3, 3] = -R.T @ t
    return T_world_camera


def camera_rays(xy_normalised: np.ndarray) -> np.ndarray:
    """Convert (..., 2) image points to (..., 3) points that are 1 m in front of a Blender camera."""
    x, y = xy_normalised[..., 0], xy_normalised[..., 1]
    return np.stack([x, -y, np.full_like(x, -1.0)], axis=-1)


def even_scale(matrices: np.ndarray, tolerance: float = _EVEN) -> np.ndarray:
    """Return the uniform scale (...) of (..., 4, 4) matrices, or NaN where the scale is not uniform."""
    R = np.asarray(matrices, np.float64)[..., :3, :3]
    scale = np.linalg.norm(R, axis=-2).mean(-1)
    axes = R / np.maximum(scale, 1e-9)[..., None, None]
    off = np.abs(axes.swapaxes(-1, -2) @ axes - np.eye(3)).max((-2, -1))
    return np.where(off < tolerance, scale, np.nan)


def euler_from_matrix(R: np.ndarray, order: str) -> np.ndarray:
    """Convert (F, ..., 3, 3) rotations to Euler angles about x, y and z that are continuous in time.

    ``R = R_k(c) R_j(b) R_i(a)`` for the order "IJK", as in Blender. Every rotation has two triples, (a, b, c) and (a +
    π, π - b, c + π). Each frame uses the triple that is closer to the previous frame's triple.
    """
    i, j, k = ("XYZ".index(letter) for letter in order)
    sign = 1.0 if (i, j, k) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0
    b = np.arcsin(np.clip(-sign * R[..., k, i], -1.0, 1.0))
    a = np.arctan2(sign * R[..., k, j], R[..., k, k])
    c = np.arctan2(sign * R[..., j, i], R[..., i, i])
    one, other = np.stack([a, b, c], axis=-1), np.stack([a + np.pi, np.pi - b, c + np.pi], axis=-1)
    stays, changes = (np.abs((next_[1:] - one[:-1] + np.pi) % (2 * np.pi) - np.pi).sum(-1) for next_ in (one, other))
    flipped = np.concatenate([np.zeros((1, *stays.shape[1:]), bool), np.cumsum(changes < stays, axis=0) % 2 == 1])
    angles = np.empty_like(one)
    angles[..., [i, j, k]] = np.unwrap(np.where(flipped[..., None], other, one), axis=0)
    return angles


def fit_units(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> None:
    """Scale objects that were built in metres to a scene that has another length unit."""
    scale = 1.0 / scene.unit_settings.scale_length
    if abs(scale - 1.0) < 1e-6:
        return
    for obj in objects:
        if obj.parent is None:
            obj.location = [scale * value for value in obj.location]
            obj.scale = [scale * value for value in obj.scale]
        if obj.type == "CAMERA":
            obj.data.clip_start, obj.data.clip_end = scale * obj.data.clip_start, scale * obj.data.clip_end
