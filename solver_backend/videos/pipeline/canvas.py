"""A small canvas for the pictures of the road's steps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.opencv import opencv
from solver_backend.exchange.errors import OutputNotWritable
from solver_backend.exchange.outputs import atomic_output

SIDE = 768
"""Pixels of a picture's longer side."""
PAPER, INK, FAINT = (30, 32, 36), (225, 225, 225), (80, 84, 90)
COLOURS = ((236, 112, 70), (82, 178, 255), (122, 204, 92), (214, 120, 230), (240, 204, 80), (120, 220, 220),
           (250, 140, 170), (170, 150, 250))  # fmt: skip
"""RGB, one a camera in turn."""

Colour = tuple[int, int, int]


class Canvas:
    """An RGB picture to draw on; pixels from the top left."""

    def __init__(self, width: int = SIDE, height: int = SIDE) -> None:
        self._cv2 = opencv()
        self.rgb = np.full((height, width, 3), PAPER, dtype=np.uint8)

    def line(self, points: np.ndarray, colour: Colour, width: int = 1, *, closed: bool = False) -> None:
        """Draw lines through points (N, 2), interrupted where they are NaN."""
        known = np.isfinite(points).all(-1)
        for part in np.split(np.arange(len(points)), np.flatnonzero(np.diff(known.astype(int))) + 1):
            if len(part) > 1 and known[part[0]]:
                where = np.round(8 * points[part]).astype(np.int32)[:, None]
                self._cv2.polylines(self.rgb, [where], closed, colour, width, self._cv2.LINE_AA, 3)

    def dots(self, points: np.ndarray, colour: Colour, radius: int = 3) -> None:
        """Draw dots at points (N, 2)."""
        for x, y in np.round(points[np.isfinite(points).all(-1)]).astype(int).tolist():
            self._cv2.circle(self.rgb, (x, y), radius, colour, -1, self._cv2.LINE_AA)

    def box(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """Fill a rectangle."""
        a, b = (round(x), round(y)), (round(x + width) - 1, round(y + height) - 1)
        self._cv2.rectangle(self.rgb, a, b, colour, -1)

    def text(self, x: float, y: float, words: str, colour: Colour = INK, size: float = 0.5) -> None:
        """Write words, their base line beginning at (x, y); letters beyond ASCII become '?'."""
        plain = words.encode("ascii", "replace").decode()
        font = self._cv2.FONT_HERSHEY_SIMPLEX
        self._cv2.putText(self.rgb, plain, (round(x), round(y)), font, size, colour, 1, self._cv2.LINE_AA)

    def text_width(self, words: str, size: float = 0.5) -> float:
        """Return how many pixels words take from left to right."""
        plain = words.encode("ascii", "replace").decode()
        (width, _), _ = self._cv2.getTextSize(plain, self._cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        return float(width)

    def picture(self, x: float, y: float, width: float, height: float, rgb: np.ndarray) -> None:
        """Lay a picture into a rectangle, as large as fits, its proportions kept."""
        scale = min(width / rgb.shape[1], height / rgb.shape[0])
        size = max(1, int(rgb.shape[1] * scale)), max(1, int(rgb.shape[0] * scale))
        small = self._cv2.resize(rgb, size, interpolation=self._cv2.INTER_AREA)
        left, top = round(x + (width - size[0]) / 2), round(y + (height - size[1]) / 2)
        self.rgb[top : top + size[1], left : left + size[0]] = small

    def save(self, path: Path) -> Path:
        """Write a PNG over what is there and return its path.

        Raises:
            OutputNotWritable: it cannot be written.
        """
        fine, data = self._cv2.imencode(".png", self.rgb[:, :, ::-1])
        if not fine:
            raise OutputNotWritable("The picture cannot be made.", where=str(path))
        with atomic_output(path, overwrite=True) as place:
            place.write_bytes(data.tobytes())
        return path


def grid(count: int) -> tuple[int, int]:
    """Return columns and rows of a grid that holds so many, nearly square."""
    columns = int(np.ceil(np.sqrt(count)))
    return columns, int(np.ceil(count / columns))


def mosaic(pictures: Sequence[np.ndarray], titles: Sequence[str]) -> Canvas:
    """Return pictures side by side, each below its title; an empty canvas where there is none."""
    if not pictures:
        return Canvas()
    columns, rows = grid(len(pictures))
    canvas = Canvas()
    width, height = SIDE / columns, SIDE / rows
    for i, (rgb, title) in enumerate(zip(pictures, titles, strict=True)):
        x, y = width * (i % columns), height * (i // columns)
        canvas.picture(x + 3, y + 22, width - 6, height - 25, rgb)
        canvas.text(x + 6, y + 16, title, COLOURS[i % len(COLOURS)])
    return canvas
