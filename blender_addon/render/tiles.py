"""Placing pictures of several shapes side by side on one canvas."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tile:
    """Where one picture goes, in pixels from the canvas's top left."""

    x: int
    y: int
    width: int
    height: int


def arrange(shapes: list[tuple[int, int]], canvas: tuple[int, int], *, columns: int | None = None) -> list[Tile]:
    """Place pictures in a grid of equal cells, each as large as its cell allows and centred in it.

    Args:
        shapes: width and height of each picture; only their ratio counts.
        canvas: width and height in pixels.
        columns: number of columns; if None, the one that covers most of the canvas.
    """
    if not shapes:
        return []
    choices = [columns] if columns else range(1, len(shapes) + 1)
    return max((_grid(shapes, canvas, n) for n in choices), key=lambda tiles: sum(t.width * t.height for t in tiles))


def _grid(shapes: list[tuple[int, int]], canvas: tuple[int, int], columns: int) -> list[Tile]:
    rows = -(-len(shapes) // columns)
    cell_w, cell_h = canvas[0] // columns, canvas[1] // rows
    tiles = []
    for i, (width, height) in enumerate(shapes):
        scale = min(cell_w / width, cell_h / height)
        # Even sizes keep the video's chroma aligned.
        w, h = max(2, int(width * scale) // 2 * 2), max(2, int(height * scale) // 2 * 2)
        x, y = (i % columns) * cell_w + (cell_w - w) // 2, (i // columns) * cell_h + (cell_h - h) // 2
        tiles.append(Tile(x, y, w, h))
    return tiles
