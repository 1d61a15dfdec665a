"""Find the visible triangle at the centre of each pixel, and its depth (z-buffer).

Pixel (0, 0) is the centre of the top-left pixel. Vertices are projected through the lens, and the edges between them
are drawn straight. For triangles of a few pixels, this is accurate to a hundredth of a pixel. Inverse depth is linear
in the image (perspective-correct interpolation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.lens import distort, is_pinhole, pixels
from solver_backend.synthesis.simulation.keypoint_detector import cross_2d
from solver_backend.types import Cameras

NEAR_M = 0.02  # Smallest depth of a triangle's corners in metres. Closer triangles are omitted.
_WIDEST = 1.2  # Largest normalised radius of a valid distortion polynomial.


@dataclass(frozen=True)
class ZBuffer:
    """Depth and triangle of each pixel in an image."""

    depth: np.ndarray  # (h, w) float32 depth in metres along the optical axis, inf where nothing is hit.
    face: np.ndarray  # (h, w) int32 index of the triangle, -1 where nothing is hit.


def in_camera(cameras: Cameras, view: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (N, 3) camera coordinates and (N, 2) pixels of world points, NaN if undefined."""
    camera = points @ cameras.R[view].T + cameras.t[view]
    z = camera[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = camera[:, :2] / np.where(z > NEAR_M, z, np.nan)[:, None]
    lens = cameras.distortion[view]
    if not is_pinhole(lens, cameras.models[view]):
        flat = np.where((flat**2).sum(-1, keepdims=True) < _WIDEST**2, flat, np.nan)
        flat = distort(flat, lens, cameras.models[view])
    return camera, pixels(flat, cameras.K[view])


def in_pictures(px: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return a (C, ...) mask of the pixels (C, ..., 2) inside each camera's image of (C, 2) size."""
    with np.errstate(invalid="ignore"):
        return ((px >= -0.5) & (px < sizes.reshape(-1, *[1] * (px.ndim - 2), 2) - 0.5)).all(axis=-1)


def rasterise(px: np.ndarray, depth: np.ndarray, faces: np.ndarray, size: tuple[int, int]) -> ZBuffer:
    """Find the nearest triangle of a mesh in each pixel of an image.

    A pixel belongs to a triangle if all three barycentric coordinates of its centre are non-negative.

    Args:
        px: (V, 2) pixels of the corners, NaN where unknown.
        depth: (V,) depths in metres along the optical axis.
        faces: (T, 3) corners, counter-clockwise when seen from outside.
        size: width and height of the image.
    """
    width, height = size
    buffer = ZBuffer(np.full((height, width), np.inf, np.float32), np.full((height, width), -1, np.int32))
    # Relative to the image centre, single precision resolves 1/10,000 pixel.
    middle = np.array([width // 2, height // 2], np.float64)
    corners = (px - middle)[faces].astype(np.float32)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = cross_2d(b - a, c - a)
    low = np.ceil(np.maximum(corners.min(axis=1), -middle)).astype(np.float32)
    high = np.floor(np.minimum(corners.max(axis=1), np.array(size) - 1 - middle)).astype(np.float32)
    spans = high - low
    shown = (area < -1e-9) & (spans >= 0).all(axis=1)
    chosen = np.flatnonzero(shown)
    if not len(chosen):
        return buffer
    columns = spans[chosen, 0].astype(np.int32) + 1
    counts = columns * (spans[chosen, 1].astype(np.int32) + 1)
    which = np.repeat(np.arange(len(chosen), dtype=np.int32), counts)
    nth = np.arange(len(which), dtype=np.int32) - np.repeat(np.cumsum(counts) - counts, counts).astype(np.int32)
    row = nth // columns[which]
    x = low[chosen, 0][which] + (nth - row * columns[which]).astype(np.float32)
    y = low[chosen, 1][which] + row.astype(np.float32)
    pa, pb, pc = a[chosen], b[chosen], c[chosen]
    inverse_area = (1.0 / area[chosen]).astype(np.float32)

    # Barycentric coordinates and inverse depth are linear in the image: ``scale * cross(edge, (x, y) - a)``.
    def at_pixels(edge: np.ndarray, scale: np.ndarray) -> np.ndarray:
        p, q, r = scale * (edge[:, 1] * pa[:, 0] - edge[:, 0] * pa[:, 1]), -scale * edge[:, 1], scale * edge[:, 0]
        return p[which] + q[which] * x + r[which] * y

    at_v, at_w = at_pixels(pc - pa, -inverse_area), at_pixels(pb - pa, inverse_area)
    inside = np.flatnonzero((at_v >= -1e-6) & (at_w >= -1e-6) & (at_v + at_w <= 1 + 1e-6))
    at_v, at_w, which = at_v[inside], at_w[inside], which[inside]
    inverse = (1.0 / np.maximum(depth, NEAR_M)).astype(np.float32)[faces[chosen]][which]
    z = 1.0 / (inverse[:, 0] * (1 - at_v - at_w) + inverse[:, 1] * at_v + inverse[:, 2] * at_w)
    pixel = ((y[inside] + middle[1]) * width + x[inside] + middle[0]).astype(np.int64)
    flat_depth, flat_face = buffer.depth.reshape(-1), buffer.face.reshape(-1)
    np.minimum.at(flat_depth, pixel, z)
    first = z == flat_depth[pixel]
    flat_face[pixel[first]] = chosen[which[first]]
    return buffer


RADIUS_M = 0.007  # Radius of a typical 14 mm marker.
_SUBSAMPLES = 5
_CLEARANCE_M = 0.012  # Largest distance in front of a sphere's centre of its own base and the skin, in metres.


@dataclass(frozen=True)
class Spheres:
    """M spherical markers in the image of one camera."""

    px: np.ndarray  # (M, 2) pixels of the centres, NaN unless in front of the camera.
    depth: np.ndarray  # (M,) depths in metres along the optical axis.
    radius_px: np.ndarray  # (M,) radii.
    seen: np.ndarray  # (M,) fraction of the disc that is inside the image and visible, 0 to 1.
    pixel: np.ndarray  # (P,) flat index of every pixel that a disc touches.
    cover: np.ndarray  # (P,) fraction of the pixel that the visible disc covers.
    owner: np.ndarray  # (P,) index of the sphere that each entry belongs to.


def see_spheres(cameras: Cameras, view: int, points: np.ndarray, scene_depth: np.ndarray) -> Spheres:
    """Compute the visibility of spheres at world points (M, 3) in front of a scene with depth (h, w).

    Each disc is sampled 5 x 5 times per pixel. A sample is hidden if the scene is clearly nearer at that pixel.
    """
    camera, px = in_camera(cameras, view, points)
    height, width = scene_depth.shape
    count = len(points)
    radius = cameras.K[view, 0, 0] * RADIUS_M / np.maximum(camera[:, 2], 0.05)
    near = np.isfinite(px).all(1) & (px > -radius[:, None] - 1).all(1)
    near &= (px < np.array([width, height]) + radius[:, None]).all(1)
    chosen = np.flatnonzero(near)
    empty = np.zeros(0, np.int64)
    if not len(chosen):
        return Spheres(px, camera[:, 2], radius, np.zeros(count), empty, np.zeros(0), empty)
    reach = int(np.ceil(radius[chosen].max())) + 1
    steps = np.arange(-reach, reach + 1)
    corner = np.round(px[chosen]).astype(np.int64)
    x, y = corner[:, 0, None, None] + steps[None, None, :], corner[:, 1, None, None] + steps[None, :, None]
    x, y = np.broadcast_arrays(x, y)
    fine = (np.arange(_SUBSAMPLES) + 0.5) / _SUBSAMPLES - 0.5
    dx = (x[..., None, None] + fine) - px[chosen, 0, None, None, None, None]
    dy = (y[..., None, None] + fine[:, None]) - px[chosen, 1, None, None, None, None]
    cover = (dx**2 + dy**2 <= radius[chosen, None, None, None, None] ** 2).mean(axis=(-1, -2))
    whole = cover.sum(axis=(1, 2))
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    flat = np.where(inside, y * width + x, 0)
    free = inside & (scene_depth.reshape(-1)[flat] > camera[chosen, 2, None, None] - _CLEARANCE_M)
    seen = np.zeros(count)
    seen[chosen] = (cover * free).sum(axis=(1, 2)) / np.maximum(whole, 1e-9)
    kept = (cover > 0) & free
    owner = np.broadcast_to(chosen[:, None, None], cover.shape)
    return Spheres(px, camera[:, 2], radius, seen, flat[kept], cover[kept], owner[kept])
