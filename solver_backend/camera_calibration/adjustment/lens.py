"""Model a lens, and estimate its parameters from images of a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.cameras.projection import cameras_by_model, distorted
from solver_backend.exchange import lens
from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float, Int

PARAMETERS = 12  # Number of lens parameters: ln fx, ln fy, cx/f, cy/f and eight coefficients.


@dataclass(frozen=True)
class FittedLens:
    """A lens model and the distortion coefficients that a calibration estimates. All other coefficients are zero."""

    name: str
    distortion_model: str  # Name of the model in ``Cameras``.
    fitted: tuple[int, ...]


LENS_MODELS = {
    name: FittedLens(name, model.name, fitted) for model in lens.LENS_MODELS.values() for name, fitted in model.fits
}
"""Lens models by name, from few to many coefficients. ``pinhole5`` has k1 k2 p1 p2 k3, ``rational8`` also k4 k5 k6."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a camera in one recording mode."""

    K: Float[np.ndarray, "3 3"]  # (3, 3) intrinsic matrix in pixels.
    distortion: Float[np.ndarray, " 8"]  # (8,) coefficients as in ``Cameras``.
    image_size: tuple[int, int]  # Width and height in pixels.
    distortion_model: str = lens.DEFAULT_MODEL

    def as_camera(self) -> Cameras:
        """Return a camera that has this lens and looks along Z from the origin."""
        return build_cameras(("camera",), [self], np.eye(3)[None], np.zeros((1, 3)))


def build_cameras(names: Sequence[str], lenses: Sequence[Lens], R: np.ndarray, t: np.ndarray) -> Cameras:
    """Combine C lenses with the camera poses R (C, 3, 3) and t (C, 3)."""
    K, distortion = (np.stack([getattr(lens, key) for lens in lenses]) for key in ("K", "distortion"))
    size = np.array([lens.image_size for lens in lenses])
    return Cameras(tuple(names), K, distortion, R, t, size, tuple(lens.distortion_model for lens in lenses))


def lens_of(cameras: Cameras, index: int) -> Lens:
    """Return the lens of the camera at an index."""
    width, height = cameras.image_size[index].tolist()
    return Lens(cameras.K[index], cameras.distortion[index], (width, height), cameras.models[index])


def lens_mask(fitted: Sequence[int] | np.ndarray = (), *, centre: bool = False) -> Bool[np.ndarray, " 12"]:
    """Return a mask of the ``PARAMETERS`` to fit: focal lengths, ``fitted`` coefficients, and optionally the centre."""
    mask = np.zeros(PARAMETERS, bool)
    mask[:2], mask[2:4], mask[[4 + i for i in fitted]] = True, centre, True
    return mask


def rough_lens(image_size: tuple[int, int], focal_share: float = 0.9) -> Lens:
    """Guess the intrinsics from the image size: ``f = share · longer side``.

    For the main cameras of phones, the share is 0.75 to 1.0. For webcams, it is 0.7 to 0.9.
    """
    width, height = image_size
    f = focal_share * max(image_size)
    return Lens(np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]]), np.zeros(8), image_size)


def moved(cameras: Cameras, step: Float[np.ndarray, "cameras 12"]) -> Cameras:
    """Apply a step s (C, 12) to the focal lengths f, the principal points c and the distortion coefficients.

    ``f ← f exp(s)`` and ``c ← c + f s``. The distortion's step is added to the coefficients.
    """
    K = cameras.K.copy()
    focal = K[:, [0, 1], [0, 1]].copy()
    K[:, [0, 1], [0, 1]] = focal * np.exp(np.clip(step[:, 0:2], -1.0, 1.0))
    K[:, :2, 2] += focal * step[:, 2:4]
    return replace(cameras, K=K, distortion=cameras.distortion + step[:, 4:])


def project_local(
    cameras: Cameras, which: Int[np.ndarray, " n"], x_cam: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 2 12"]]:
    """Project points from camera axes to pixels. Also return the derivatives by point coordinates and lens parameters.

    Args:
        cameras: C cameras, whose poses are ignored.
        which: (N,) index of the camera for each point.
        x_cam: (N, 3) positions in metres. Points behind the camera result in NaN.

    Returns:
        Pixels (N, 2), and their derivatives with respect to the point (N, 2, 3) in px/m and to ``PARAMETERS`` (N, 2,
        12).

    Reference: OpenCV 4, "Camera Calibration and 3D Reconstruction" (lens model). The derivatives were derived by hand.
    """
    px, x, y, z, bent_x, bent_y, (xx, cross, yy) = _projected(cameras, which, x_cam)
    K = cameras.K[which]
    fx, fy = K[:, 0, 0], K[:, 1, 1]
    rows = np.stack([xx, cross, -(xx * x + cross * y), cross, yy, -(cross * x + yy * y)], axis=-1).reshape(-1, 2, 3)
    by_point = K[:, :2, :2] @ (rows / z[:, None, None])
    by_lens = np.zeros((len(px), 2, PARAMETERS))
    by_lens[:, 0, 0], by_lens[:, 1, 1] = fx * bent_x, fy * bent_y
    by_lens[:, 0, 2], by_lens[:, 1, 3] = fx, fy
    by_lens[:, :, 4:] = K[:, :2, :2] @ _by_coefficients(cameras, which, x, y)
    return px, by_point, by_lens


def pixels_of(
    cameras: Cameras, which: Int[np.ndarray, " n"], x_cam: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2"]:
    """Project points from camera axes to pixels (N, 2), as ``project_local`` does, without derivatives."""
    return _projected(cameras, which, x_cam)[0]


def _projected(cameras: Cameras, which: np.ndarray, x_cam: np.ndarray) -> tuple[Any, ...]:
    z = np.where(x_cam[:, 2] > 1e-6, x_cam[:, 2], np.nan)
    x, y = x_cam[:, 0] / z, x_cam[:, 1] / z
    bent_x, bent_y, slopes = _distorted(cameras, which, x, y)
    K = cameras.K[which]
    px = np.stack([K[:, 0, 0] * bent_x + K[:, 0, 1] * bent_y + K[:, 0, 2], K[:, 1, 1] * bent_y + K[:, 1, 2]], axis=-1)
    return px, x, y, z, bent_x, bent_y, slopes


def _distorted(cameras: Cameras, which: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[Any, ...]:
    groups = cameras_by_model(cameras.models)
    if len(groups) == 1:
        return distorted(x, y, cameras.distortion[which], cameras.models[:1])
    found = np.full((5, len(x)), np.nan)
    for model, views in groups:
        at = np.isin(which, views)
        bent_x, bent_y, slopes = distorted(x[at], y[at], cameras.distortion[which[at]], (model.name,))
        found[:, at] = bent_x, bent_y, *slopes
    return found[0], found[1], tuple(found[2:])


def _by_coefficients(cameras: Cameras, which: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the derivatives (N, 2, 8) of distorted coordinates with respect to the distortion coefficients."""
    J = np.zeros((len(x), 2, PARAMETERS - 4))
    for model, views in cameras_by_model(cameras.models):
        at = np.isin(which, views)
        J[at] = model.by_terms(x[at], y[at], cameras.distortion[which[at]])
    return J


def homogeneous(xy: np.ndarray) -> np.ndarray:
    """Append a coordinate of 1 to points (..., d) in d dimensions."""
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


def dlt_rows(points: Float[np.ndarray, "n d"], image: Float[np.ndarray, "n 2"]) -> np.ndarray:
    """Return the equations (n, 2, 3 d + 3) of the direct linear transform from d-dimensional points to images."""
    h = homogeneous(points)
    none = np.zeros_like(h)
    return np.stack([np.hstack([h, none, -image[:, :1] * h]), np.hstack([none, h, -image[:, 1:] * h])], axis=1)


def homography(plane: Float[np.ndarray, "n 2"], image: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 3"]:
    """Estimate H in ``image ~ H plane`` by the normalised direct linear transform.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", algorithm 4.2.
    """
    (a, A), (b, B) = _centred(plane), _centred(image)
    H = np.linalg.svd(dlt_rows(a, b).reshape(-1, 9))[2][-1].reshape(3, 3)
    return np.linalg.inv(B) @ H @ A


def focal_from_homographies(
    homographies: Float[np.ndarray, "views 3 3"], centre: Float[np.ndarray, " 2"]
) -> float | None:
    """Estimate the focal length in px from board homographies, or return None if they do not determine it.

    The board axes h1 and h2, the first columns of a homography relative to the principal point ``centre``, must be
    orthogonal and equally long: ``h1ᵀ ω h2 = 0`` and ``h1ᵀ ω h1 = h2ᵀ ω h2`` with ``ω = diag(1/f², 1/f², 1)``.

    Reference: Zhang 2000, "A flexible new technique for camera calibration", eqs. 3 and 4.
    """
    shift = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, 1.0]])
    H = shift @ homographies
    H = H / np.linalg.norm(H[:, :, :2], axis=(1, 2), keepdims=True)
    a, b = H[:, :, 0], H[:, :, 1]
    left = np.concatenate([(a * b)[:, :2].sum(-1), (a**2 - b**2)[:, :2].sum(-1)])
    right = -np.concatenate([(a * b)[:, 2], a[:, 2] ** 2 - b[:, 2] ** 2])
    inverse_square = float(left @ right) / max(float(left @ left), 1e-30)
    return float(inverse_square**-0.5) if inverse_square > 1e-12 else None


def planar_pose(
    plane: Float[np.ndarray, "n 2"], normalised: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Estimate a board's pose in camera axes from points on the board and in the image (Zhang 2000, sec. 3.1)."""
    H = homography(plane, normalised)
    H = H / np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1]))
    if H[2, 2] < 0:
        H = -H
    R = nearest_rotation(np.stack([H[:, 0], H[:, 1], np.cross(H[:, 0], H[:, 1])], axis=-1))
    return np.asarray(R), H[:, 2]


def _centred(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shift and scale points to mean 0 and mean distance √2 from the origin. Also return this transform (3, 3)."""
    mean = points.mean(0)
    scale = np.sqrt(2.0) / max(float(np.linalg.norm(points - mean, axis=1).mean()), 1e-12)
    return (points - mean) * scale, np.array([[scale, 0, -scale * mean[0]], [0, scale, -scale * mean[1]], [0, 0, 1.0]])
