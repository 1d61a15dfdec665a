"""Draw lines, dots, boxes, text and images into an RGB image with NumPy."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing
from solver_backend.exchange.outputs import atomic_output
from solver_backend.io.png import png_bytes


def opencv() -> Any:
    """Import ``cv2``, which the ``capture`` extra installs. Raise ``BackendMissing`` if that fails."""
    try:
        return import_module("cv2")
    except ImportError as error:
        message = "This step needs OpenCV, which is not installed."
        if not isinstance(error, ModuleNotFoundError):
            message = f"This step needs OpenCV, which cannot be imported: {error}."
        hint = "Install it with: pip install opencv-contrib-python-headless. In Blender, use a zip with it."
        raise BackendMissing(message, hint=hint) from error


SIDE = 768  # Length of the longer side of a drawn image in pixels.
PAPER, INK = (30, 32, 36), (225, 225, 225)
Colour = tuple[int, int, int]  # RGB.
_STROKES = (
    "A062046 1434|B0006 003041423303 033344453606|C4130100105163645|D00062644422000|E40000646 0333|F400006 0333|"
    "G41301001051636454323|H0006 4046 0343|I1030 2026 1636|J4045361605|K0006 400346|L000646|M0600234046|N06004640|"
    "O103041453616050110|P06003041423303|Q103041453616050110 2446|R06003041423303 2346|S413010010213334445361605|"
    "T0040 2026|U000516364540|V002640|W0016233640|X0046 4006|Y002340 2326|Z00400646|a12324346 441405163645|"
    "b0006 063645433202|c4332120305163645|d4046 421203051646|e04444332120305163645|f40302126 1232|"
    "g42473818 421203051646|h0006 0312324346|i2226 2020|j32372818 3030|k0006 420446|l2026|m0602 03122326 23324346|"
    "n0602 0312324346|o123243453616050312|p0802 023243453606|q4248 421203051646|r0206 031232|s4212031434453606|"
    "t20253646 0242|u0205163645 4246|v022642|w0216233642|x0246 4206|y0225 4208|z02420646|0103041453616050110 3115|"
    "1112026|201103041420646|3004022334445361605|436300444|54000023243453606|63020020516364544331304|7004016|"
    "8103041423313020110 130405163645443313|91626444130100102133342|.2626|,2617|:2323 2626|;2323 2617|-1434|"
    "+2226 0444|%0640 0101 4545|(30212536|)10212516|_0747|/0640|'2021|?011030414224 2626|=0343 0545|<420446|>024406|"
    "*2226 0345 0543|[30202636|]10202616"
)
"""Strokes of each letter as points on a grid, x from 0 to 4 and y from 0 to 8. The base line is at 6."""
_LETTERS = {
    entry[0]: [
        np.array([[int(n) for n in pair] for pair in zip(s[::2], s[1::2], strict=True)]) for s in entry[1:].split()
    ]
    for entry in _STROKES.split("|")
}
_CELL_PX, _ADVANCE = 3.2, 5.6  # Pixels per grid cell at size 1, and cells from one letter to the next.


class Canvas:
    """An RGB image to draw on. Coordinates are pixels from the top left corner."""

    def __init__(self, width: int = SIDE, height: int = SIDE) -> None:
        self.rgb = np.full((height, width, 3), PAPER, dtype=np.uint8)

    def line(self, points: np.ndarray, colour: Colour, width: float = 1, *, closed: bool = False) -> None:
        """Draw connected lines through points (N, 2). NaN interrupts a line."""
        points = np.asarray(points, dtype=np.float64)
        ends = np.concatenate([points[1:], points[:1]]) if closed else points[1:]
        for a, b in zip(points, ends, strict=False):
            if np.isfinite(a).all() and np.isfinite(b).all():
                self._stroke(a, b, colour, 0.5 * width)

    def dots(self, points: np.ndarray, colour: Colour, radius: float = 3) -> None:
        """Draw dots at (N, 2) points."""
        for place in np.asarray(points, dtype=np.float64):
            if np.isfinite(place).all():
                self._stroke(place, place, colour, radius)

    def box(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """Draw a filled rectangle."""
        top, left = max(round(y), 0), max(round(x), 0)
        self.rgb[top : max(round(y + height), 0), left : max(round(x + width), 0)] = colour

    def text(self, x: float, y: float, words: str, colour: Colour = INK, size: float = 0.5) -> None:
        """Write text with its base line starting at (x, y). Non-ASCII characters become '?'."""
        cell = _CELL_PX * size
        for place, letter in enumerate(words):
            for stroke in [] if letter == " " else _LETTERS.get(letter, _LETTERS["?"]):
                shown = np.array([x + place * _ADVANCE * cell, y - 6 * cell]) + stroke * cell
                self.line(shown, colour, 0.5 + size)

    def text_width(self, words: str, size: float = 0.5) -> float:
        """Return the width of a text in pixels."""
        return _ADVANCE * _CELL_PX * size * len(words)

    def picture(self, x: float, y: float, width: float, height: float, rgb: np.ndarray) -> None:
        """Draw an image inside a rectangle, with its aspect ratio preserved."""
        scale = min(width / rgb.shape[1], height / rgb.shape[0])
        size = max(1, int(rgb.shape[1] * scale)), max(1, int(rgb.shape[0] * scale))
        small = np.round(_resized(_resized(rgb.astype(np.float32), size[1], 0), size[0], 1)).astype(np.uint8)
        left, top = round(x + (width - size[0]) / 2), round(y + (height - size[1]) / 2)
        self.rgb[top : top + size[1], left : left + size[0]] = small

    def save(self, path: Path) -> Path:
        """Write the canvas as PNG, and return the path. An existing file is replaced."""
        with atomic_output(path, overwrite=True) as place:
            place.write_bytes(png_bytes(self.rgb))
        return path

    def _stroke(self, a: np.ndarray, b: np.ndarray, colour: Colour, radius: float) -> None:
        """Draw an anti-aliased line segment with round ends."""
        last = np.array(self.rgb.shape[1::-1]) - 1
        low = np.clip(np.floor(np.minimum(a, b) - radius - 1), 0, last + 1).astype(int)
        high = np.clip(np.ceil(np.maximum(a, b) + radius + 1), -1, last).astype(int) + 1
        if (high <= low).any():
            return
        x, y = np.arange(low[0], high[0]) - a[0], np.arange(low[1], high[1])[:, None] - a[1]
        way = b - a
        along = np.clip((x * way[0] + y * way[1]) / max(float(way @ way), 1e-12), 0.0, 1.0)
        distance = np.hypot(x - along * way[0], y - along * way[1])
        cover = np.clip(radius + 0.5 - distance, 0.0, 1.0)[..., None]
        part = self.rgb[low[1] : high[1], low[0] : high[0]]
        part[:] = np.round(part + cover * (np.array(colour) - part.astype(np.float64)))


def _resized(picture: np.ndarray, size: int, axis: int) -> np.ndarray:
    """Resize one axis of an image by averaging over equal parts of the axis."""
    count = picture.shape[axis]
    total = np.insert(np.cumsum(picture, axis=axis), 0, 0.0, axis=axis)
    at = np.linspace(0.0, count, size + 1)
    low = np.minimum(at.astype(int), count - 1)
    shape = [-1 if n == axis else 1 for n in range(picture.ndim)]
    sums = total.take(low, axis) + (at - low).astype(np.float32).reshape(shape) * picture.take(low, axis)
    return np.diff(sums, axis=axis) * (size / count)
