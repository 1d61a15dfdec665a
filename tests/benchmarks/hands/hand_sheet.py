"""Contact sheet of the hands of a real take: every view of some frames, with detections and the solved hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from solver_backend.exchange.joint_sets import SIDES
from solver_backend.types import Capture
from solver_backend.videos.detect.find_hands import pictures_of

COLUMNS = 8  # Number of frames of a sheet, evenly distributed over the take.
CELL = 220  # Side of a cell in pixels.
REACH = 2.2  # Side of a cell's view in hand lengths.
BONES = [(0, 1), *((a, a + 1) for a in range(1, 4)), *((0, 4 * f + 1) for f in range(1, 5))]
BONES += [(4 * f + k, 4 * f + k + 1) for f in range(1, 5) for k in range(1, 4)]
"""Lines between points of a hand."""
SOLVED, DETECTED = (0, 255, 0), (255, 60, 60)  # Colours of the lines.


def draw_sheet(capture: Capture, px: np.ndarray, path: Path) -> None:
    """Write a picture with a row for each view and side, with solved hands in green and detections in red.

    Args:
        capture: capture with footage and hands.
        px: (C, F, 2, 21, 2) pixel positions of the solved hands in the views.
        path: path of the PNG.
    """
    assert capture.keypoints is not None and capture.keypoints.hands is not None
    hands, views = capture.keypoints.hands, len(px)
    columns = {int(f): i for i, f in enumerate(np.linspace(0, px.shape[1] - 1, COLUMNS + 2)[1:-1])}
    sheet = Image.new("RGB", (COLUMNS * CELL, views * 2 * CELL))
    for frame, pictures in pictures_of(capture):
        if frame not in columns:
            continue
        for view, rgb in pictures.items():
            for side in range(2):
                found = hands[view, frame, side]
                cell = _cell(rgb, px[view, frame, side], found)
                ImageDraw.Draw(cell).text((4, 4), f"{view} {SIDES[side]} {frame}", fill=(255, 255, 0))
                sheet.paste(cell, (columns[frame] * CELL, (2 * view + side) * CELL))
    sheet.save(path)


def _cell(rgb: np.ndarray, solved: np.ndarray, found: np.ndarray) -> Image.Image:
    length = float(np.linalg.norm(solved - solved[:1], axis=-1).max())
    middle, half = solved.mean(axis=0), REACH * max(length, 10.0) / 2
    low = middle - half
    cell = Image.fromarray(rgb).crop([*low.tolist(), *(middle + half).tolist()]).resize((CELL, CELL))  # type: ignore[arg-type]
    draw, scale = ImageDraw.Draw(cell), CELL / (2 * half)
    for points, colour in ((solved, SOLVED), (found[:, :2], DETECTED)):
        if colour is DETECTED and not (found[:, 2] > 0).all():
            continue
        at = [tuple(p) for p in ((points - low) * scale).tolist()]
        for a, b in BONES:
            draw.line([at[a], at[b]], fill=colour)
    return cell
