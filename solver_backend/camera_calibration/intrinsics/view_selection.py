"""Which pictures of a board are used: sharp ones that together cover the picture, tilts and distances."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic

MOST_VIEWS = 40
"""Pictures a lens is fitted to."""
BLUR_SHARE = 0.4
"""A picture less sharp than this share of the camera's 80 % quantile is left out."""
CELLS = (8, 6)
"""Cells of the picture, across and down, that corners should fall into."""


def selected_views(board: Board, sightings: Mapping[int, BoardSighting], image_size: tuple[int, int]) -> list[int]:
    """Return frames of sharp pictures, one by one the picture that differs most from those chosen before.

    Pictures differ by where the board's corners lie, in picture heights; corners that are seen count.

    Args:
        board: what is seen.
        sightings: of one camera by frame.
        image_size: width and height, px.

    Reference: Gonzalez 1985 (farthest point first).
    """
    frames = sorted(sightings)
    if not frames:
        return []
    bar = BLUR_SHARE * float(np.quantile([sightings[f].sharpness for f in frames], 0.8))
    sharp = [f for f in frames if sightings[f].sharpness >= bar] or frames
    if len(sharp) <= MOST_VIEWS:
        return sharp
    signature = np.stack([_signature(board, sightings[f]) for f in sharp]) / min(image_size)
    chosen = [int(np.argmax([len(sightings[f].ids) * sightings[f].spacing_px for f in sharp]))]
    distance = np.linalg.norm(signature - signature[chosen[0]], axis=1)
    while len(chosen) < MOST_VIEWS:
        farthest = int(np.argmax(distance))
        chosen.append(farthest)
        distance = np.minimum(distance, np.linalg.norm(signature - signature[farthest], axis=1))
    return sorted(sharp[i] for i in chosen)


def coverage(sightings: list[BoardSighting], image_size: tuple[int, int]) -> np.ndarray:
    """Return how many corners fell into each cell of the picture, (down, across)."""
    across, down = CELLS
    count = np.zeros((down, across), dtype=int)
    for view in sightings:
        cell = (view.px / np.array(image_size) * CELLS).astype(int)
        inside = ((cell >= 0) & (cell < CELLS)).all(-1)
        np.add.at(count, (cell[inside, 1], cell[inside, 0]), 1)
    return count


def advice(
    sightings: list[BoardSighting], image_size: tuple[int, int], tilted: int, camera: str
) -> tuple[Diagnostic, ...]:
    """Return what to film again; nothing where the pictures suffice.

    Args:
        sightings: the pictures that were used.
        image_size: width and height, px.
        tilted: how many of them show the board turned by more than 15 degrees.
        camera: its name.
    """
    words: list[Diagnostic] = []
    if len(sightings) < 12:
        words.append(diagnostic("board_pictures_few", cameras=[camera], count=len(sightings)))
    seen = coverage(sightings, image_size) > 0
    down, across = seen.shape
    parts = {
        "left": seen[:, : across // 4], "right": seen[:, -(across // 4) :],
        "top": seen[: down // 3], "bottom": seen[-(down // 3) :],
    }  # fmt: skip
    bare = [name for name, part in parts.items() if part.mean() < 0.4]
    if bare:
        words.append(diagnostic("board_parts_bare", cameras=[camera], parts=bare))
    if tilted < min(5, len(sightings)):
        words.append(diagnostic("board_tilts_few", cameras=[camera], count=tilted))
    share = float(np.median([_extent(v) for v in sightings])) / min(image_size) if sightings else 0.0
    if sightings and share < 0.25:
        words.append(diagnostic("board_small", cameras=[camera], percent=100 * share))
    return tuple(words)


def coverage_svg(sightings: list[BoardSighting], image_size: tuple[int, int], title: str) -> str:
    """Return a picture of all corners in the camera's picture."""
    width, height = image_size
    dots = "".join(f'<circle cx="{x:.0f}" cy="{y:.0f}" r="{width / 200:.1f}"/>' for v in sightings for x, y in v.px)
    hulls = "".join(f'<path d="{_outline(v)}"/>' for v in sightings)
    clean = "".join(c for c in title if c not in "<>&")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width // 2}" '
        f'height="{height // 2}"><title>{clean}</title><rect width="{width}" height="{height}" fill="#f4f4f4" '
        f'stroke="#555"/><g fill="none" stroke="#1f77b4" stroke-opacity="0.3" stroke-width="{width / 500:.1f}">'
        f'{hulls}</g><g fill="#d62728" fill-opacity="0.5">{dots}</g></svg>\n'
    )


def _signature(board: Board, view: BoardSighting) -> np.ndarray:
    """Return where the board's four corners would lie, by a homography's affine part: (8,) px."""
    points = board.points
    h = np.concatenate([points[view.ids, :2], np.ones((len(view.ids), 1))], axis=1)
    affine = np.linalg.lstsq(h, view.px, rcond=None)[0]
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    corners = np.array([[low[0], low[1], 1], [high[0], low[1], 1], [high[0], high[1], 1], [low[0], high[1], 1]])
    return (corners @ affine).ravel()


def _extent(view: BoardSighting) -> float:
    return float(np.ptp(view.px, axis=0).max())


def _outline(view: BoardSighting) -> str:
    centre = view.px.mean(0)
    order = np.argsort(np.arctan2(*(view.px - centre).T))
    far = [view.px[order][part].tolist() for part in range(0, len(order), max(1, len(order) // 8))]
    return "M" + "L".join(f"{x:.0f} {y:.0f}" for x, y in far) + "Z"
