"""Placing pictures of several shapes side by side."""

from __future__ import annotations

from dataclasses import dataclass

GAP = 4
"""Pixels between pictures."""


@dataclass(frozen=True)
class PictureTile:
    """Where one picture goes, in pixels from the canvas's top left; sizes are even, as video wants them."""

    x: int
    y: int
    width: int
    height: int


def pack(shapes: list[tuple[int, int]], area: tuple[int, int]) -> list[PictureTile]:
    """Place pictures in rows of equal height, as large as a canvas of about this area allows.

    Of all numbers of rows the one is taken whose canvas is shaped most like ``area``.

    Args:
        shapes: width and height of each picture; only their ratio counts.
        area: width and height in pixels of the canvas that has the wanted number of pixels.
    """
    if not shapes:
        return []
    choices = [_rows(shapes, rows, area) for rows in range(1, len(shapes) + 1)]
    wanted = area[0] / area[1]

    def misfit(tiles: list[PictureTile]) -> float:
        width, height = canvas_size(tiles)
        return max(width / height / wanted, wanted / (width / height))

    return min(choices, key=misfit)


def row(shapes: list[tuple[int, int]], width: int, most_height: int) -> list[PictureTile]:
    """Place pictures in one row of equal height, as wide as ``width``, or centred in it at ``most_height``."""
    if not shapes:
        return []
    ratio = sum(w / h for w, h in shapes)
    height = min(most_height, int((width - GAP * (len(shapes) - 1)) / ratio))
    tiles = _row(shapes, height, 0)
    left = max(0, (width - tiles[-1].x - tiles[-1].width) // 2)
    return [PictureTile(tile.x + left, 0, tile.width, tile.height) for tile in tiles]


def canvas_size(tiles: list[PictureTile]) -> tuple[int, int]:
    """Return the even width and height that hold all tiles."""
    width, height = max(t.x + t.width for t in tiles), max(t.y + t.height for t in tiles)
    return width + width % 2, height + height % 2


def _rows(shapes: list[tuple[int, int]], rows: int, area: tuple[int, int]) -> list[PictureTile]:
    per_row = -(-len(shapes) // rows)
    groups = [shapes[i : i + per_row] for i in range(0, len(shapes), per_row)]
    ratios = [sum(w / h for w, h in group) for group in groups]
    # The widest row has ``max(ratios)`` times its height; the rows together cover the wanted number of pixels.
    height = int((area[0] * area[1] / (max(ratios) * len(groups))) ** 0.5)
    tiles = []
    for i, group in enumerate(groups):
        placed = _row(group, height, i * (_even(height) + GAP))
        left = int((max(ratios) - ratios[i]) * height / 2)
        tiles += [PictureTile(tile.x + left, tile.y, tile.width, tile.height) for tile in placed]
    return tiles


def _row(shapes: list[tuple[int, int]], height: int, y: int) -> list[PictureTile]:
    tiles, x = [], 0
    for width, own_height in shapes:
        tiles.append(PictureTile(x, y, _even(height * width / own_height), _even(height)))
        x += tiles[-1].width + GAP
    return tiles


def _even(length: float) -> int:
    return max(2, round(length / 2) * 2)
