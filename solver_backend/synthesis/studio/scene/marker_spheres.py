"""Retro-reflective spheres in a picture: where they appear, how large, and how much of each is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.synthesis.studio.scene.z_buffer import in_camera
from solver_backend.types import Cameras

RADIUS_M = 0.007
"""Of a common 14 mm marker."""
_SUBSAMPLES = 5
_CLEARANCE_M = 0.012
"""What lies less than this before a sphere's middle is the sphere's own base and the skin it sits on."""


@dataclass(frozen=True)
class Spheres:
    """M spheres in one picture."""

    px: np.ndarray
    """(M, 2) pixels of their middles, NaN where not before the camera."""
    depth: np.ndarray
    """(M,) metres along the axis."""
    radius_px: np.ndarray
    """(M,)."""
    seen: np.ndarray
    """(M,) share of the disc that is in the picture and hidden by nothing, 0..1."""
    pixel: np.ndarray
    """(P,) flat index of every pixel that some disc reaches."""
    cover: np.ndarray
    """(P,) share of it that the disc covers and that is seen."""
    owner: np.ndarray
    """(P,) which sphere."""


def see_spheres(cameras: Cameras, view: int, points: np.ndarray, scene_depth: np.ndarray) -> Spheres:
    """Return what a camera sees of spheres at (M, 3) world points before a scene's (h, w) depth.

    Each disc is sampled 5 x 5 times a pixel; a sample is hidden where the scene's pixel is clearly nearer.
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
