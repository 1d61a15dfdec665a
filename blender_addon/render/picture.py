"""Pictures as NumPy arrays: read Blender's Targa frames, write PNG, blend layers and draw dots.

Pictures are (height, width, 3) uint8 sRGB arrays, top row first. A layer is a (height, width, 4) float32 array from 0
to 1, with premultiplied alpha.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ..errors import RenderFailed


def read_targa(path: Path) -> np.ndarray:
    """Read an uncompressed 24 or 32 bit Targa file as an (h, w, 3 or 4) uint8 RGB(A) array, top row first."""
    data = path.read_bytes() if path.is_file() else b""
    width, height, depth, descriptor = struct.unpack("<HHBB", data[12:18]) if len(data) >= 18 else (0, 0, 0, 0)
    start = 18 + (data[0] if data else 0)
    channels = depth // 8
    if len(data) < start + width * height * channels or channels not in (3, 4) or data[2] != 2:
        hint = "Rendering needs OpenGL. Without a display, install EGL and Mesa (libegl1, libgl1-mesa-dri)."
        raise RenderFailed("Blender did not write an image.", where=path.name, hint=hint)
    pixels = np.frombuffer(data, np.uint8, width * height * channels, start).reshape(height, width, channels)
    order = (2, 1, 0, 3)[:channels]
    return pixels[:, :, order] if descriptor & 0x20 else pixels[::-1, :, order]


def write_png(path: Path, picture: np.ndarray, *, level: int = 6) -> None:
    """Write an (h, w, 3) uint8 picture as PNG (ISO/IEC 15948), with zlib's compression ``level`` (0 to 9)."""
    height, width = picture.shape[:2]
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)
    rows[:, 1:] = picture.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), level)), (b"IEND", b""))
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def layer_from_render(pixels: np.ndarray, shrink: int = 1) -> np.ndarray:
    """Return a layer made from (h, w, 4) uint8 RGBA by averaging blocks of ``shrink`` x ``shrink`` pixels."""
    height, width = pixels.shape[0] // shrink, pixels.shape[1] // shrink
    total = np.zeros((height, width, 4), dtype=np.float32)
    for i in range(shrink):
        for j in range(shrink):
            part = pixels[i : height * shrink : shrink, j : width * shrink : shrink].astype(np.float32)
            part[..., :3] *= part[..., 3:] / 255
            total += part
    return total / (255 * shrink**2)


def blend(picture: np.ndarray, layer: np.ndarray, x: int, y: int, *, opacity: float = 1.0) -> None:
    """Blend a layer over a picture, in place. The layer's top left corner is at (x, y)."""
    x0, y0 = max(x, 0), max(y, 0)
    x1, y1 = min(x + layer.shape[1], picture.shape[1]), min(y + layer.shape[0], picture.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    part = layer[y0 - y : y1 - y, x0 - x : x1 - x] * np.float32(opacity)
    mixed = picture[y0:y1, x0:x1] * (1 - part[..., 3:]) + part[..., :3] * 255 + np.float32(0.5)
    picture[y0:y1, x0:x1] = np.minimum(mixed, 255)


def soften_edges(layer: np.ndarray) -> np.ndarray:
    """Smooth the outline of a layer with a 3 x 3 binomial filter."""
    soft = np.pad(layer, ((1, 1), (1, 1), (0, 0)))
    soft = soft[:-2] + 2 * soft[1:-1] + soft[2:]
    soft = (soft[:, :-2] + 2 * soft[:, 1:-1] + soft[:, 2:]) / 16
    outline = (soft[..., 3:] > 0) & (soft[..., 3:] < 1 - 1e-6)
    return np.where(outline, soft, layer)


def draw_dots(picture: np.ndarray, centres: np.ndarray, radius: float, colour: tuple[float, float, float]) -> None:
    """Draw round dots with a dark rim at (N, 2) pixel positions, in an sRGB colour."""
    reach = int(np.ceil(radius + 2))
    size = np.array(picture.shape[1::-1])
    known = centres[np.isfinite(centres).all(axis=1)]
    known = known[((known > -reach) & (known < size + reach)).all(axis=1)]
    corner = np.round(known).astype(int)
    grid = np.arange(-reach, reach + 1, dtype=np.float32)
    u, v = (known - corner).astype(np.float32).T[:, :, None, None]
    distance = np.hypot(grid[None, None, :] - u, grid[None, :, None] - v)
    fill, rim = np.clip(radius + 0.5 - distance, 0, 1), 0.6 * np.clip(radius + 1.5 - distance, 0, 1)
    layers = np.stack([*(fill * c for c in colour), np.maximum(fill, rim)], axis=-1)
    for layer, (x, y) in zip(layers, corner - reach, strict=True):
        blend(picture, layer, int(x), int(y))


def gradient(width: int, height: int) -> np.ndarray:
    """Return a neutral backdrop that is darker towards the top."""
    shade = np.linspace(0.0, 1.0, height)[:, None, None]
    top, bottom = np.array([40.0, 44.0, 52.0]), np.array([92.0, 97.0, 106.0])
    return np.broadcast_to(top + (bottom - top) * shade, (height, width, 3)).astype(np.uint8)


class Resampling:
    """Samples pictures bilinearly at (h, w, 2) pixel positions."""

    def __init__(self, positions: np.ndarray, size: tuple[int, int], outside: tuple[int, int, int]) -> None:
        width, height = size
        u, v = np.clip(positions[..., 0], 0, width - 1), np.clip(positions[..., 1], 0, height - 1)
        x, y = np.minimum(u.astype(int), max(width - 2, 0)), np.minimum(v.astype(int), max(height - 2, 0))
        a, b = (u - x).astype(np.float32)[..., None], (v - y).astype(np.float32)[..., None]
        right, down = int(width > 1), width * int(height > 1)
        first = y * width + x
        self._corners = (first, first + right, first + down, first + right + down)
        self._weights = ((1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b)
        self._outside = ((positions < -0.5) | (positions > np.array(size) - 0.5)).any(axis=-1)
        self._colour = outside

    def __call__(self, picture: np.ndarray) -> np.ndarray:
        """Sample a (height, width, 3) uint8 source, and return an (h, w, 3) uint8 picture."""
        flat = picture.reshape(-1, 3)
        total = np.full((*self._outside.shape, 3), 0.5, dtype=np.float32)
        for corner, weight in zip(self._corners, self._weights, strict=True):
            total += np.take(flat, corner, axis=0) * weight
        bent = total.astype(np.uint8)
        bent[self._outside] = self._colour
        return bent
