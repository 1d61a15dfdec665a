"""A picture of where a camera saw the board, for windows that show no SVG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.camera_calibration.intrinsics.view_selection import coverage
from solver_backend.camera_calibration.opencv import opencv
from solver_backend.exchange.errors import OutputNotWritable
from solver_backend.exchange.outputs import atomic_output

WIDTH = 480
"""Width of the picture, pixels; chosen by hand."""
_PAPER, _CELL, _CORNER = (66, 60, 56), (74, 92, 58), (70, 112, 236)


def write_coverage_png(sightings: Sequence[BoardSighting], image_size: tuple[int, int], path: Path) -> None:
    """Write a PNG of all corners in the camera's picture; cells of the picture that the board reached are green.

    Raises:
        BackendMissing: OpenCV is not installed.
        OutputNotWritable: the file cannot be written.
    """
    cv2 = opencv()
    scale = WIDTH / image_size[0]
    height = max(1, round(image_size[1] * scale))
    bgr = np.full((height, WIDTH, 3), _PAPER, dtype=np.uint8)
    seen = coverage(list(sightings), image_size) > 0
    down, across = seen.shape
    for row, column in np.argwhere(seen).tolist():
        a = round(WIDTH * column / across), round(height * row / down)
        b = round(WIDTH * (column + 1) / across) - 2, round(height * (row + 1) / down) - 2
        cv2.rectangle(bgr, a, b, _CELL, -1)
    for view in sightings:
        for x, y in np.round(view.px * scale).astype(int).tolist():
            cv2.circle(bgr, (x, y), 2, _CORNER, -1, cv2.LINE_AA)
    fine, data = cv2.imencode(".png", bgr)
    if not fine:
        raise OutputNotWritable("The picture cannot be made.", where=str(path))
    with atomic_output(path, overwrite=True) as place:
        place.write_bytes(data.tobytes())
