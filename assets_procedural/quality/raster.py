"""A small z-buffer renderer for contact sheets: no GPU, no display, the same picture everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.skeleton.skinning import vertex_normals
from solver_backend.io.png import png_bytes

_KEY, _FILL, _TOP = np.array([-0.45, 0.55, 0.70]), np.array([0.87, 0.11, 0.44]), np.array([0.0, 1.0, 0.0])
_BACKGROUND = np.array([0.90, 0.91, 0.93])  # Linear colour behind the body, chosen by hand.


@dataclass(frozen=True)
class RasterView:
    """An orthographic camera, turned about y by ``yaw`` and tipped by ``pitch`` degrees; ``height_m`` metres high."""

    yaw: float = 0.0
    pitch: float = 0.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height_m: float = 1.9
    size: tuple[int, int] = (480, 480)  # Width and height in pixels.

    @property
    def turn(self) -> Array:
        """Return the (3, 3) rotation into view axes: x right, y up, z towards the viewer."""
        a, b = np.deg2rad([self.yaw, self.pitch])
        about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
        return about_x @ about_y


def render(vertices: Array, faces: Array, colours: Array, view: RasterView, oversample: int = 2) -> Array:
    """Return an (H, W, 3) uint8 picture with smooth shading of faces with (F, 3) colours in [0, 1].

    ``oversample`` counts samples along each side of a pixel.
    """
    width, height = (oversample * s for s in view.size)
    scale = height / view.height_m
    seen = (vertices - np.array(view.centre)) @ view.turn.T
    normals = vertex_normals(seen, faces)
    xy = np.stack([seen[:, 0] * scale + width / 2, height / 2 - seen[:, 1] * scale], axis=1)
    depth = np.full((height, width), -np.inf)
    normal, colour = np.zeros((height, width, 3)), np.zeros((height, width, 3))
    for face, tint in zip(faces, colours, strict=True):
        _fill(xy[face], seen[face, 2], normals[face], tint, depth, normal, colour)
    image = np.where(np.isfinite(depth)[..., None], _shade(normal) * colour, _BACKGROUND).clip(0, 1) ** (1 / 1.6)
    blocks = image.reshape(height // oversample, oversample, width // oversample, oversample, 3)
    return np.round(255 * blocks.mean(axis=(1, 3))).astype(np.uint8)


def _fill(xy: Array, z: Array, normals: Array, tint: Array, depth: Array, normal: Array, colour: Array) -> None:
    height, width = depth.shape
    x0, y0 = np.maximum(np.floor(xy.min(axis=0)).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(xy.max(axis=0)).astype(int) + 1, (width, height))
    (ax, ay), (bx, by), (cx, cy) = xy
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area >= 0 or x1 <= x0 or y1 <= y0:  # image y points down, so faces towards the viewer are negative
        return
    x, y = np.arange(x0, x1)[None], np.arange(y0, y1)[:, None]
    v = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
    w = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
    u = 1.0 - v - w
    here = u * z[0] + v * z[1] + w * z[2]
    window = (slice(y0, y1), slice(x0, x1))
    visible = (u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9) & (here > depth[window])
    depth[window][visible] = here[visible]
    blended = u[..., None] * normals[0] + v[..., None] * normals[1] + w[..., None] * normals[2]
    normal[window][visible] = blended[visible]
    colour[window][visible] = tint


def _shade(normal: Array) -> Array:
    n = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    light = 0.15 + 0.10 * (n @ _TOP).clip(0, 1)
    for direction, strength in ((_KEY, 0.66), (_FILL, 0.22)):
        light = light + strength * (n @ (direction / np.linalg.norm(direction))).clip(0, 1)
    return light[..., None]


def tile(images: list[Array], columns: int) -> Array:
    """Return equally large pictures as one, row by row. The last row is filled with background."""
    blank = np.broadcast_to(np.round(255 * _BACKGROUND ** (1 / 1.6)).astype(np.uint8), images[0].shape)
    padded = images + [blank] * (-len(images) % columns)
    rows = [np.concatenate(padded[i : i + columns], axis=1) for i in range(0, len(padded), columns)]
    return np.concatenate(rows, axis=0)


def write_png(path: Path, image: Array) -> None:
    """Write an (H, W, 3) uint8 picture."""
    path.write_bytes(png_bytes(image))
