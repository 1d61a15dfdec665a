"""Draw pictures with OpenCV."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing, OutputNotWritable
from solver_backend.exchange.outputs import atomic_output


def opencv() -> Any:
    """Import ``cv2``. Raise ``BackendMissing`` if it is not installed. It belongs to the extra ``capture``."""
    try:
        return import_module("cv2")
    except ImportError as error:
        hint = "Install it with: pip install opencv-contrib-python-headless."
        raise BackendMissing("Pictures and videos are read by OpenCV, which is not installed.", hint=hint) from error


SIDE = 768  # Longer side of a drawn picture in pixels.
PAPER, INK = (30, 32, 36), (225, 225, 225)
Colour = tuple[int, int, int]  # RGB.


class Canvas:
    """An RGB picture to draw on, with pixels from the top left."""

    def __init__(self, width: int = SIDE, height: int = SIDE) -> None:
        self._cv2 = opencv()
        self.rgb = np.full((height, width, 3), PAPER, dtype=np.uint8)

    def line(self, points: np.ndarray, colour: Colour, width: int = 1, *, closed: bool = False) -> None:
        """Draw lines through (N, 2) points, interrupted at NaN."""
        known = np.isfinite(points).all(-1)
        for part in np.split(np.arange(len(points)), np.flatnonzero(np.diff(known.astype(int))) + 1):
            if len(part) > 1 and known[part[0]]:
                where = np.round(8 * points[part]).astype(np.int32)[:, None]
                self._cv2.polylines(self.rgb, [where], closed, colour, width, self._cv2.LINE_AA, 3)

    def dots(self, points: np.ndarray, colour: Colour, radius: int = 3) -> None:
        """Draw dots at (N, 2) points."""
        for x, y in np.round(points[np.isfinite(points).all(-1)]).astype(int).tolist():
            self._cv2.circle(self.rgb, (x, y), radius, colour, -1, self._cv2.LINE_AA)

    def box(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """Fill a rectangle."""
        a, b = (round(x), round(y)), (round(x + width) - 1, round(y + height) - 1)
        self._cv2.rectangle(self.rgb, a, b, colour, -1)

    def text(self, x: float, y: float, words: str, colour: Colour = INK, size: float = 0.5) -> None:
        """Write text with its base line starting at (x, y). Letters beyond ASCII become '?'."""
        plain = words.encode("ascii", "replace").decode()
        font = self._cv2.FONT_HERSHEY_SIMPLEX
        self._cv2.putText(self.rgb, plain, (round(x), round(y)), font, size, colour, 1, self._cv2.LINE_AA)

    def text_width(self, words: str, size: float = 0.5) -> float:
        """Return the width of text in pixels."""
        plain = words.encode("ascii", "replace").decode()
        (width, _), _ = self._cv2.getTextSize(plain, self._cv2.FONT_HERSHEY_SIMPLEX, size, 1)
        return float(width)

    def picture(self, x: float, y: float, width: float, height: float, rgb: np.ndarray) -> None:
        """Fit a picture into a rectangle, with its proportions."""
        scale = min(width / rgb.shape[1], height / rgb.shape[0])
        size = max(1, int(rgb.shape[1] * scale)), max(1, int(rgb.shape[0] * scale))
        small = self._cv2.resize(rgb, size, interpolation=self._cv2.INTER_AREA)
        left, top = round(x + (width - size[0]) / 2), round(y + (height - size[1]) / 2)
        self.rgb[top : top + size[1], left : left + size[0]] = small

    def save(self, path: Path) -> Path:
        """Write a PNG over an earlier one and return its path. Raise ``OutputNotWritable`` if that fails."""
        fine, data = self._cv2.imencode(".png", self.rgb[:, :, ::-1])
        if not fine:
            raise OutputNotWritable("The picture cannot be made.", where=str(path))
        with atomic_output(path, overwrite=True) as place:
            place.write_bytes(data.tobytes())
        return path
