"""Project world points through distorted lenses to pixels, and convert pixels to normalised coordinates.

Pixels and Jacobians are NaN for points less than ``NEAR_M`` in front of a camera, and for points beyond the radius at
which the lens distortion stops being monotonic (``largest_radius``). The depth of every finite point is finite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from solver_backend.exchange.lens import DEFAULT_MODEL, LENS_MODELS, require_models
from solver_backend.exchange.lens_model import LensModel
from solver_backend.geometry.arrays import Array, array_namespace, astype, constant, device_of, replaced
from solver_backend.geometry.small_matrices import squared_length
from solver_backend.types.cameras import CameraPath, Cameras
from solver_backend.types.shapes import Float

ImagePoints = Float[Array, "cameras *batch 2"]  # Pixels, or normalised coordinates.
Coordinate = Float[Array, "cameras *batch"]
Distortion = Float[Array, "cameras 8"]
Models = tuple[str, ...]
"""Lens model of each camera, or a single one for all cameras."""

NEWTON_STEPS = 20
_RADII = np.tan(np.linspace(0.0, 1.56, 768))
"""Radii at which the slope of the distortion is computed, for angles between 0 and 89.4°."""


@lru_cache(maxsize=64)
def cameras_by_model(models: Models) -> tuple[tuple[LensModel, tuple[int, ...]], ...]:
    """Group camera indices by lens model. Raise ``CalibrationInvalid`` if a model is unknown."""
    require_models(models)
    names = dict.fromkeys(models or (DEFAULT_MODEL,))
    return tuple((LENS_MODELS[name], tuple(c for c, other in enumerate(models) if other == name)) for name in names)


def is_distorted(distortion: Distortion, models: Models) -> bool:
    """Return whether any camera deviates from the pinhole model."""
    straight = all(model.is_straight for model, _ in cameras_by_model(models))
    return not straight or bool(array_namespace(distortion).any(distortion != 0))


def _by_model(models: Models, compute: Callable[..., Any], *arrays: Array) -> Any:
    """Call ``compute(model, *arrays)`` once per lens model, and merge the results in camera order."""
    groups = cameras_by_model(models)
    if len(groups) == 1:
        return compute(groups[0][0], *arrays)
    parts = [compute(model, *(array[list(rows)] for array in arrays)) for model, rows in groups]
    at = {c: (g, i) for g, (_, rows) in enumerate(groups) for i, c in enumerate(rows)}
    return _merge(parts, [at[c] for c in range(len(models))])


def _merge(parts: Sequence[Any], at: Sequence[tuple[int, int]]) -> Any:
    if isinstance(parts[0], tuple):
        return tuple(_merge([part[i] for part in parts], at) for i in range(len(parts[0])))
    return array_namespace(parts[0]).stack([parts[group][row] for group, row in at], axis=0)


def distort(xy: ImagePoints, distortion: Distortion, models: Models) -> ImagePoints:
    """Distort normalised coordinates. The result is only valid within ``largest_radius``.

    Args:
        xy: (C, ..., 2) normalised coordinates x/z and y/z.
        distortion: (C, 8) distortion coefficients.
        models: lens models of the C cameras.
    """
    x, y, _ = distorted(xy[..., 0], xy[..., 1], distortion, models)
    return array_namespace(xy).stack((x, y), axis=-1)


def distorted(
    x: Coordinate, y: Coordinate, distortion: Distortion, models: Models
) -> tuple[Coordinate, Coordinate, tuple[Coordinate, Coordinate, Coordinate]]:
    """Distort coordinates x and y (C, ...). Also return the entries xx, xy and yy of the symmetric Jacobian."""

    def of_model(model: LensModel, x: Array, y: Array, distortion: Array) -> tuple[Array, Array, tuple[Array, ...]]:
        return model.distort(x, y, _coefficients(distortion, x), array_namespace(x))

    return _by_model(models, of_model, x, y, distortion)


def largest_radius(distortion: Distortion, models: Models) -> Float[Array, " cameras"]:
    """Return each lens's largest radius sqrt(x² + y²) with invertible radial distortion.

    Beyond this radius, the distortion polynomial decreases, and distant points would be projected into the image. The
    radius is searched on a grid of angles and refined by interpolation. It is infinite if the distortion increases up
    to 89.4°.
    """
    if isinstance(distortion, np.ndarray):  # cached, because every projection needs the same few lenses
        return _known_radius(distortion.tobytes(), distortion.dtype.str, models)
    return _by_model(models, _largest_radius, distortion)


@lru_cache(maxsize=64)
def _known_radius(distortion: bytes, dtype: str, models: Models) -> np.ndarray:
    """Compute ``largest_radius`` for coefficients given as bytes, so that it can be cached. The array is read-only."""
    radius = np.asarray(_by_model(models, _largest_radius, np.frombuffer(distortion, dtype).reshape(-1, 8)))
    radius.flags.writeable = False
    return radius


def _largest_radius(model: LensModel, distortion: Array) -> Array:
    xp = array_namespace(distortion)
    r = constant(_RADII, distortion)
    u = (r * r)[None, :] * xp.ones_like(distortion[:, :1])
    growth, meaningless = model.growth(u, _coefficients(distortion, u), xp)
    broken = ~(growth > 0) | meaningless
    folds = xp.any(broken, axis=-1)
    first = xp.argmax(xp.astype(broken, growth.dtype), axis=-1)
    before = xp.where(first > 0, first - 1, xp.zeros_like(first))
    rows = xp.arange(growth.shape[0])
    inner, outer = growth[rows, before], growth[rows, first]
    share = inner / xp.where(inner > outer, inner - outer, xp.ones_like(inner))
    share = xp.where((outer <= 0) & (inner > outer), share, xp.zeros_like(share))
    return xp.where(folds, r[before] + share * (r[first] - r[before]), xp.full_like(inner, math.inf))


def undistort_normalised(xy: ImagePoints, distortion: Distortion, models: Models) -> ImagePoints:
    """Invert ``distort``: return undistorted normalised coordinates (C, ..., 2).

    The result is NaN if ``distort`` maps no point within ``largest_radius`` to ``xy``.
    """
    xp = array_namespace(xy)
    if not is_distorted(distortion, models):
        return xy
    limit = _per_camera(largest_radius(distortion, models), xy[..., 0])
    found = _by_model(models, _invert, xy, distortion, limit)
    error = xp.sqrt(squared_length(distort(found, distortion, models) - xy))
    radius = xp.sqrt(squared_length(found))
    good = (error < 2e3 * xp.finfo(xy.dtype).eps * (1.0 + radius)) & (radius <= limit)
    return xp.where(good[..., None], found, xp.full_like(found, math.nan))


def _invert(model: LensModel, xy: Array, distortion: Array, limit: Array) -> Array:
    if model.invert is not None:
        return model.invert(xy, _coefficients(distortion, xy[..., 0]), array_namespace(xy))
    return _invert_in_plane(model, xy, distortion, limit)


def _invert_in_plane(model: LensModel, xy: Array, distortion: Array, limit: Array) -> Array:
    xp = array_namespace(xy)
    flat = xp.reshape(xy, (xy.shape[0], -1, 2))
    target = [xp.where(xp.isfinite(part), part, xp.zeros_like(part)) for part in (flat[..., 0], flat[..., 1])]
    guess, limit = [xp.asarray(part, copy=True) for part in target], xp.reshape(limit, (-1, 1))
    k, least = _coefficients(distortion, guess[0]), 64.0 * xp.finfo(xy.dtype).eps  # the error is the step squared
    active = xp.arange(flat.shape[1], device=device_of(xy))  # columns that some camera has not finished
    before = xp.zeros_like(guess[0], dtype=xp.bool)
    for _ in range(NEWTON_STEPS):
        x, y, outside = _pulled_inside(guess[0][:, active], guess[1][:, active], limit)
        at_x, at_y, (xx, cross, yy) = model.distort(x, y, k, xp)
        ex, ey = target[0][:, active] - at_x, target[1][:, active] - at_y
        determinant = xx * yy - cross * cross
        singular = xp.abs(determinant) < 1e-12
        determinant = xp.where(singular, xp.ones_like(determinant), determinant)
        steps = (yy * ex - cross * ey) / determinant, (xx * ey - cross * ex) / determinant
        step_x, step_y = (xp.where(singular, xp.zeros_like(step), step) for step in steps)
        guess[0][:, active], guess[1][:, active] = x + step_x, y + step_y
        # A point that leaves the limit again after it was pulled inside has no inverse, because the slope is positive.
        moving = ((xp.abs(step_x) >= least) | (xp.abs(step_y) >= least)) & ~(outside & before)
        columns = xp.any(moving, axis=0)
        if not bool(xp.any(columns)):
            break
        active, before = active[columns], outside[:, columns]
    return xp.reshape(xp.stack(guess, axis=-1), tuple(xy.shape))


def _pulled_inside(x: Array, y: Array, limit: Array) -> tuple[Array, Array, Array]:
    """Move points beyond the radius limit towards the centre, to 99.9 % of the limit. Return a mask of them, too."""
    xp = array_namespace(x)
    radius = xp.sqrt(x * x + y * y)
    outside = radius > limit
    if not bool(xp.any(outside)):
        return x, y, outside
    shrink = 0.999 * xp.where(outside, limit, xp.ones_like(limit)) / xp.where(outside, radius, xp.ones_like(radius))
    return xp.where(outside, x * shrink, x), xp.where(outside, y * shrink, y), outside


def _coefficients(distortion: Array, like: Array) -> list[Array]:
    """Split distortion (C, 8) into eight arrays (C, 1, ..., 1) that broadcast to ``like`` (C, ...)."""
    return [_per_camera(distortion[:, i], like) for i in range(8)]


def _per_camera(value: Array, like: Array) -> Array:
    return array_namespace(value).reshape(value, (value.shape[0],) + (1,) * (like.ndim - 1))


Points = Float[Array, "*batch 3"]

NEAR_M = 0.01  # Depth in metres below which points are not projected.


@dataclass(frozen=True)
class CameraArrays:
    """C cameras as arrays of the caller's array library. The values are not validated."""

    K: Array
    """(C, 3, 3) intrinsic matrices in px."""
    distortion: Array
    """(C, 8) lens distortion coefficients."""
    R: Array
    """(C, 3, 3) rotations from world to camera."""
    t: Array
    """(C, 3) translations in metres."""
    models: Models
    width: float = 0.0
    """Mean image width in px."""
    path: CameraPath | None = None
    """Motion of the cameras if they move."""

    @classmethod
    def of(cls, cameras: Cameras, like: Array) -> CameraArrays:
        """Convert cameras to the array type of ``like``."""
        K, distortion, R, t = (constant(a, like) for a in (cameras.K, cameras.distortion, cameras.R, cameras.t))
        path = cameras.path and CameraPath(constant(cameras.path.R, like), constant(cameras.path.t, like))
        return cls(K, distortion, R, t, cameras.models, float(cameras.image_size[:, 0].mean()), path)

    def astype(self, precision: Any) -> CameraArrays:
        """Convert the arrays to the given floating-point precision."""
        K, distortion, R, t = (astype(a, precision) for a in (self.K, self.distortion, self.R, self.t))
        path = self.path and CameraPath(astype(self.path.R, precision), astype(self.path.t, precision))
        return replace(self, K=K, distortion=distortion, R=R, t=t, path=path)

    def at(self, frames: Any) -> CameraArrays:
        """Select frames of a moving camera's path by a slice or an index array."""
        return self if self.path is None else replace(self, path=self.path.at(frames))


AnyCameras = Cameras | CameraArrays


def project(cameras: AnyCameras, points: Points) -> ImagePoints:
    """Project world points to pixels (C, ..., 2): ``K distort((R x + t)/z)``.

    Moving cameras need points (F, ..., 3), one row per frame. The pixels are NaN for points behind the camera, and for
    points beyond the valid radius of the lens distortion (``largest_radius``).

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 6.1, with lens distortion.
    """
    K = cameras.K
    xp = array_namespace(K, points)
    x, y, _, valid = _normalised(cameras, points)
    if is_distorted(cameras.distortion, cameras.models):
        x, y, _ = distorted(x, y, cameras.distortion, cameras.models)
    return xp.reshape(_to_pixels(K, x, y, valid), (K.shape[0], *points.shape[:-1], 2))


def project_with_jacobian(
    cameras: AnyCameras, points: Points
) -> tuple[ImagePoints, Float[Array, "cameras *batch 2 3"], Coordinate]:
    """Return the pixels of world points, their derivatives (C, ..., 2, 3) in px/m, and the depths (C, ...) in m."""
    K = cameras.K
    xp = array_namespace(K, points)
    x, y, z, valid = _normalised(cameras, points)
    inverse_z = 1.0 / replaced(z, ~valid, math.nan)
    xx, cross, yy = xp.ones_like(z), xp.zeros_like(z), xp.ones_like(z)
    bent_x, bent_y = x, y
    if is_distorted(cameras.distortion, cameras.models):
        bent_x, bent_y, (xx, cross, yy) = distorted(x, y, cameras.distortion, cameras.models)
    xx, cross, yy = xx * inverse_z, cross * inverse_z, yy * inverse_z
    row_x, row_y = (xx, cross, -(xx * x + cross * y)), (cross, yy, -(cross * x + yy * y))
    fx, skew, fy = K[:, 0, 0, None], K[:, 0, 1, None], K[:, 1, 1, None]
    if bool(xp.any(skew != 0)):
        row_x = tuple(a + skew / fx * b for a, b in zip(row_x, row_y, strict=True))
    in_camera = xp.stack([fx * a for a in row_x] + [fy * b for b in row_y], axis=-1)
    J = xp.matmul(xp.reshape(in_camera, (K.shape[0], -1, 3)), cameras.R)
    if cameras.path is not None:
        J = xp.matmul(xp.reshape(J, (K.shape[0], len(cameras.path), -1, 3)), cameras.path.R)
    px, shape = _to_pixels(K, bent_x, bent_y, valid), (K.shape[0], *points.shape[:-1])
    return xp.reshape(px, (*shape, 2)), xp.reshape(J, (*shape, 2, 3)), xp.reshape(z, shape)


def undistort(cameras: AnyCameras, xy: ImagePoints) -> ImagePoints:
    """Convert pixels to undistorted normalised coordinates x/z and y/z (C, ..., 2).

    The result is NaN for NaN pixels, and for pixels that no point is projected to. Poses are ignored.
    """
    K = cameras.K
    xp = array_namespace(K, xy)
    flat = xp.reshape(xy, (xy.shape[0], -1, 2))
    y = (flat[..., 1] - K[:, 1, 2, None]) / K[:, 1, 1, None]
    x = (flat[..., 0] - K[:, 0, 2, None] - K[:, 0, 1, None] * y) / K[:, 0, 0, None]
    n = undistort_normalised(xp.stack((x, y), axis=-1), cameras.distortion, cameras.models)
    return xp.reshape(n, tuple(xy.shape))


def _normalised(cameras: AnyCameras, points: Array) -> tuple[Array, Array, Array, Array]:
    """Transform points to camera axes. Return x/z and y/z (0 where invalid), depth and validity, all (C, N)."""
    xp = array_namespace(cameras.R, points)
    if cameras.path is not None:
        at = xp.reshape(points, (len(cameras.path), -1, 3))
        points = xp.matmul(at, xp.matrix_transpose(cameras.path.R)) + cameras.path.t[:, None]
    camera = xp.matmul(cameras.R, xp.reshape(points, (-1, 3)).T) + cameras.t[:, :, None]
    z = camera[:, 2]
    valid = z > NEAR_M
    inverse = 1.0 / replaced(z, ~valid, 1.0)
    x, y = camera[:, 0] * inverse, camera[:, 1] * inverse
    if is_distorted(cameras.distortion, cameras.models):
        valid = valid & (x * x + y * y <= largest_radius(cameras.distortion, cameras.models)[:, None] ** 2)
    return replaced(x, ~valid, 0.0), replaced(y, ~valid, 0.0), z, valid


def _to_pixels(K: Array, x: Array, y: Array, valid: Array) -> Array:
    """Convert normalised x and y (C, N) to pixels (C, N, 2), NaN where ``valid`` is false."""
    xp = array_namespace(K, x)
    u, v = K[:, 0, 0, None] * x + K[:, 0, 1, None] * y + K[:, 0, 2, None], K[:, 1, 1, None] * y + K[:, 1, 2, None]
    px = xp.stack((u, v), axis=-1)
    px[~valid] = math.nan
    return px
