"""Draw a board on pages and write them as PDF or SVG."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from xml.sax.saxutils import escape

import numpy as np

from solver_backend.camera_calibration.boards.board import Board, charuco_boards
from solver_backend.camera_calibration.pictures import opencv
from solver_backend.exchange.errors import JobInvalid

PAPERS = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
"""Width and height in mm, upright."""
MARGIN_MM, FOOT_MM, RULER_MM = 10.0, 22.0, 100.0  # Margin, height of the foot and length of the ruler, in mm.
RING = (0.36, 0.18)  # Outer and inner radius of a ring, in distances between two rows (half of ``square``).


@dataclass(frozen=True)
class Polygon:
    """A filled polygon."""

    points: np.ndarray  # (n, 2) mm from the page's top left corner, Y down.
    white: bool = False


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
    """A line of text. ``place`` is the left end of its base line."""

    place: tuple[float, float]
    text: str
    size: float = 3.5
    """Height of a line in mm."""


Shape = Polygon | Disc | PageLine | PageText


@dataclass(frozen=True)
class Page:
    """A printed page."""

    size: tuple[float, float]
    """Width and height in mm."""
    shapes: tuple[Shape, ...]
    first_point: tuple[float, float]
    """Position of the board's first point in mm."""


def board_page(board: Board, paper: str = "fit") -> Page:
    """Return the page of a board with a ruler of 100 mm to check the printer's scale.

    Args:
        paper: a name of ``PAPERS``, or 'fit' for a page as large as needed. It is turned if needed.

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
    # The first point is in the middle of the first ring's cell, or at the first inner corner.
    first = 1000.0 * board.square_m / (2 if board.kind == "rings" else 1)
    return Page(size, (*shapes, *_foot(board, size)), (left + first, top + first))


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
    message = f"The board needs {needed[0]:.0f} x {needed[1]:.0f} mm; {paper} has {upright[0]:g} x {upright[1]:g}."
    hint = f"Take squares of {int(share * board.square_m * 1000)} mm, larger paper, or --paper fit for a print shop."
    raise JobInvalid(message, hint=hint)


def _pattern(board: Board) -> list[Shape]:
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
                x, y = low[0] + start * module, low[1] + row * module
                shapes.append(_rectangle(x, y, (stop - start) * module, module))
    return shapes


def _foot(board: Board, size: tuple[float, float]) -> list[Shape]:
    base = size[1] - MARGIN_MM
    left = (size[0] - RULER_MM) / 2
    marks = [PageLine((left + i, base), (left + i, base - (4.0 if i % 10 == 0 else 2.0))) for i in range(0, 101, 5)]
    text = f"This line must measure 100 mm; print at 100 %, without fitting. {board}"[:90]
    return [PageLine((left, base), (left + RULER_MM, base)), *marks, PageText((left, base - 6.0), text, 2.8)]


def _rectangle(x: float, y: float, width: float, height: float) -> Polygon:
    return Polygon(np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]]))


def _moved(shape: Shape, x: float, y: float, inverted: bool) -> Shape:
    if isinstance(shape, Polygon):
        return Polygon(shape.points + [x, y], shape.white != inverted)
    if isinstance(shape, Disc):
        return Disc((shape.centre[0] + x, shape.centre[1] + y), shape.radius, shape.white != inverted)
    return shape


POINTS_PER_MM = 72.0 / 25.4  # PDF units per millimetre (1/72 inch).
_KAPPA = 0.5522847498  # Length of the Bézier handles of a quarter circle, in radii.
_THIN_MM = 0.15  # Width of a thin line in millimetres. Chosen by hand.


def svg(page: Page) -> str:
    """Return the page as SVG in millimetres."""
    width, height = page.size
    shapes = "\n".join(_svg_shape(shape) for shape in page.shapes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" shape-rendering="crispEdges">\n'
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>\n{shapes}\n</svg>\n'
    )


def _svg_shape(shape: Shape) -> str:
    if isinstance(shape, PageLine):
        (x1, y1), (x2, y2) = shape.start, shape.end
        ends = f'x1="{x1:.6g}" y1="{y1:.6g}" x2="{x2:.6g}" y2="{y2:.6g}"'
        return f'<line {ends} stroke="black" stroke-width="{_THIN_MM}"/>'
    if isinstance(shape, PageText):
        (x, y), font = shape.place, f'font-family="Helvetica, Arial" font-size="{shape.size}"'
        return f'<text x="{x:.6g}" y="{y:.6g}" {font}>{escape(shape.text)}</text>'
    fill = 'fill="white"' if shape.white else 'fill="black"'
    if isinstance(shape, Polygon):
        points = " ".join(f"{x:.6g},{y:.6g}" for x, y in shape.points)
        return f'<polygon points="{points}" {fill}/>'
    return f'<circle cx="{shape.centre[0]:.6g}" cy="{shape.centre[1]:.6g}" r="{shape.radius:.6g}" {fill}/>'


def pdf(page: Page) -> bytes:
    """Return the page as PDF 1.4. A matrix turns millimetres with Y down into points with Y up.

    Reference: ISO 32000-1, 7.5 (file structure), 8.5 (paths).
    """
    width, height = (POINTS_PER_MM * length for length in page.size)
    matrix = f"{POINTS_PER_MM:.9f} 0 0 {-POINTS_PER_MM:.9f} 0 {height:.6f} cm"
    drawing = "\n".join(["q", matrix, f"{_THIN_MM} w", *(_pdf_shape(s) for s in page.shapes), "Q"])
    stream = drawing.encode("latin-1", "replace")
    box = f"[0 0 {width:.6f} {height:.6f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        f"<< /Length {len(stream)} >>\nstream\n".encode() + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    out, places = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"), []
    for number, content in enumerate(objects, start=1):
        places.append(len(out))
        out += f"{number} 0 obj\n".encode() + content + b"\nendobj\n"
    table = len(out)
    entries = "".join(f"{place:010d} 00000 n \n" for place in places)
    out += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{entries}".encode()
    out += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n".encode()
    return bytes(out)


def _pdf_shape(shape: Shape) -> str:
    if isinstance(shape, PageLine):
        (x1, y1), (x2, y2) = shape.start, shape.end
        return f"0 G {x1:.6f} {y1:.6f} m {x2:.6f} {y2:.6f} l S"
    if isinstance(shape, PageText):
        (x, y), text = shape.place, shape.text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        return f"0 g BT /F1 {shape.size:g} Tf 1 0 0 -1 {x:.6f} {y:.6f} Tm ({text}) Tj ET"
    grey = "1 g" if shape.white else "0 g"
    if isinstance(shape, Polygon):
        (x, y), *rest = shape.points
        path = [f"{x:.6f} {y:.6f} m", *(f"{a:.6f} {b:.6f} l" for a, b in rest), "h f"]
        return f"{grey} " + " ".join(path)
    return f"{grey} {_circle(*shape.centre, shape.radius)} f"


def _circle(x: float, y: float, r: float) -> str:
    k = _KAPPA * r
    corners = ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 0))
    quarters = [
        ((r * a + k * c, r * b + k * d), (k * a + r * c, k * b + r * d), (r * c, r * d))
        for (a, b), (c, d) in pairwise(corners)
    ]
    curves = [" ".join(f"{x + a:.6f} {y + b:.6f}" for a, b in q) + " c" for q in quarters]
    return f"{x + r:.6f} {y:.6f} m " + " ".join(curves)
