"""A board on a sheet of paper, as polygons, circles, lines and words in millimetres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.camera_calibration.boards.board import Board
from solver_backend.camera_calibration.boards.detection import charuco_boards
from solver_backend.camera_calibration.opencv import opencv
from solver_backend.exchange.errors import JobInvalid

PAPERS = {
    "A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0), "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4), "tabloid": (279.4, 431.8),
}  # fmt: skip
"""Width and height in mm, upright."""
MARGIN_MM, FOOT_MM, RULER_MM = 10.0, 22.0, 100.0
RING = (0.36, 0.18)
"""Outer and inner radius of a ring, in distances of two rows' neighbours (half of ``square``)."""


@dataclass(frozen=True)
class Polygon:
    """A filled polygon."""

    points: np.ndarray
    """(n, 2) mm from the page's top left corner, Y down."""
    white: bool = False
    """White rather than black."""


@dataclass(frozen=True)
class Disc:
    """A filled circle."""

    centre: tuple[float, float]
    radius: float
    white: bool = False


@dataclass(frozen=True)
class PageLine:
    """A thin black line."""

    start: tuple[float, float]
    end: tuple[float, float]


@dataclass(frozen=True)
class PageText:
    """A line of text; ``place`` is the left end of its base line."""

    place: tuple[float, float]
    text: str
    size: float = 3.5
    """Height of a line, mm."""


Shape = Polygon | Disc | PageLine | PageText


@dataclass(frozen=True)
class Page:
    """What is printed."""

    size: tuple[float, float]
    """Width and height, mm."""
    shapes: tuple[Shape, ...]
    """Painted in this order."""
    first_point: tuple[float, float]
    """Where the board's first point lies, mm."""


def board_page(board: Board, paper: str = "fit") -> Page:
    """Return the page of a board with a ruler of 100 mm to check the printer's scale by.

    Args:
        board: what is drawn.
        paper: a name of ``PAPERS``, or 'fit' for a page as large as needed; turned where it then fits.

    Raises:
        JobInvalid: the paper is unknown, or the board does not fit on it.
        BackendMissing: a Charuco board without OpenCV, which has the markers.
    """
    width, height = (1000.0 * length for length in board.size_m)
    needed = max(width, RULER_MM) + 2 * MARGIN_MM, height + 2 * MARGIN_MM + FOOT_MM
    size = _paper(paper, needed, board)
    left, top = (size[0] - width) / 2, (size[1] - FOOT_MM - height) / 2
    shapes: list[Shape] = []
    if board.inverted:
        shapes.append(_rectangle(left - 5, top - 5, width + 10, height + 10))
    shapes += [_moved(shape, left, top, board.inverted) for shape in _pattern(board)]
    first = _first(board)
    shapes += _foot(board, size)
    return Page(size, tuple(shapes), (left + first[0], top + first[1]))


def _paper(paper: str, needed: tuple[float, float], board: Board) -> tuple[float, float]:
    if paper == "fit":
        return needed
    by_name = {name.lower(): size for name, size in PAPERS.items()}
    if paper.lower() not in by_name:
        raise JobInvalid(f"There is no paper '{paper}'.", hint=f"There are {', '.join(PAPERS)} and fit.")
    upright = by_name[paper.lower()]
    turned = upright[1], upright[0]
    for size in (upright, turned):
        if needed[0] <= size[0] and needed[1] <= size[1]:
            return size
    share = max(min(s[0] / needed[0], s[1] / needed[1]) for s in (upright, turned))
    raise JobInvalid(
        f"The board needs {needed[0]:.0f} x {needed[1]:.0f} mm; {paper} has {upright[0]:g} x {upright[1]:g}.",
        hint=f"Take squares of {int(share * board.square_m * 1000)} mm, larger paper, or --paper fit for a print shop.",
    )


def _first(board: Board) -> tuple[float, float]:
    """Return where the first point lies from the pattern's corner, mm."""
    side = 1000.0 * board.square_m
    return (side / 2, side / 2) if board.kind == "rings" else (side, side)


def _pattern(board: Board) -> list[Shape]:
    """Return the board's black shapes in mm from its top left corner."""
    side = 1000.0 * board.square_m
    if board.kind == "rings":
        centres = 1000.0 * board.points[:, :2] + side / 2
        outer, inner = (share * side / 2 for share in RING)
        return [Disc((x, y), r, white) for x, y in centres for r, white in ((outer, False), (inner, True))]
    if board.kind == "checkerboard":
        cells = [(c, r) for r in range(board.rows) for c in range(board.columns) if (c + r) % 2 == 0]
        return [_rectangle(c * side, r * side, side, side) for c, r in cells]
    return _charuco(board, side)


def _charuco(board: Board, side: float) -> list[Shape]:
    made = charuco_boards(board)[0]
    corners = [1000.0 * np.asarray(quad)[:, :2] for quad in made.getObjPoints()]
    with_marker = {(int(q[:, 0].mean() // side), int(q[:, 1].mean() // side)) for q in corners}
    cells = [(c, r) for r in range(board.rows) for c in range(board.columns) if (c, r) not in with_marker]
    shapes: list[Shape] = [_rectangle(c * side, r * side, side, side) for c, r in cells]
    aruco = opencv().aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, board.dictionary))
    modules = dictionary.markerSize + 2
    for number, quad in zip(np.ravel(made.getIds()), corners, strict=True):
        bits = aruco.generateImageMarker(dictionary, int(number), modules)
        low, module = quad.min(0), 1000.0 * board.marker_m / modules
        for row in range(modules):
            dark = np.flatnonzero(np.diff(np.concatenate([[0], bits[row] < 128, [0]])))
            for start, stop in dark.reshape(-1, 2):
                shapes.append(
                    _rectangle(low[0] + start * module, low[1] + row * module, (stop - start) * module, module)
                )
    return shapes


def _foot(board: Board, size: tuple[float, float]) -> list[Shape]:
    base = size[1] - MARGIN_MM
    left = (size[0] - RULER_MM) / 2
    marks = [PageLine((left + i, base), (left + i, base - (4.0 if i % 10 == 0 else 2.0))) for i in range(0, 101, 5)]
    return [
        PageLine((left, base), (left + RULER_MM, base)), *marks,
        PageText(
            (left, base - 6.0), f"This line must measure 100 mm; print at 100 %, without fitting. {board}"[:90], 2.8
        ),
    ]  # fmt: skip


def _rectangle(x: float, y: float, width: float, height: float) -> Polygon:
    return Polygon(np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]]))


def _moved(shape: Shape, x: float, y: float, inverted: bool) -> Shape:
    if isinstance(shape, Polygon):
        return Polygon(shape.points + [x, y], shape.white != inverted)
    if isinstance(shape, Disc):
        return Disc((shape.centre[0] + x, shape.centre[1] + y), shape.radius, shape.white != inverted)
    return shape
