"""Draw a calibration board on a page, and write the page as PDF or SVG."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
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
"""Width and height of each paper size in mm, in portrait format."""
MARGIN_MM, FOOT_MM, RULER_MM = 10.0, 22.0, 100.0  # Margin, height of the footer and length of the ruler, in mm.
RING = (0.36, 0.18)  # Outer and inner radius of a ring, relative to the distance between rows (half of ``square``).
_CORNERS = 96  # Number of corners of a drawn circle. The error is then 4 µm at a radius of 7 mm.


@dataclass(frozen=True)
class Polygon:
    """A filled black or white polygon on the page."""

    points: np.ndarray  # (n, 2) mm from the top left corner of the page, Y down.
    white: bool = False


@dataclass(frozen=True)
class Page:
    """A page to print. Positions are in mm from its top left corner."""

    size: tuple[float, float]
    polygons: tuple[Polygon, ...]
    lines: np.ndarray  # (n, 2, 2) end points of the lines in the ruler.
    text: str
    text_place: tuple[float, float]  # Left end of the text's base line.


def board_page(board: Board, paper: str = "fit") -> Page:
    """Draw the page for a board, with a 100 mm ruler to check the printer's scale.

    Args:
        paper: a name in ``PAPERS``, or 'fit' for a page that is just large enough. The page is rotated if necessary.

    Raises:
        JobInvalid: the paper is unknown, or the board does not fit on it.
        BackendMissing: OpenCV, which draws the markers of a Charuco board, is not installed.
    """
    width, height = (1000.0 * length for length in board.size_m)
    needed = max(width, RULER_MM) + 2 * MARGIN_MM, height + 2 * MARGIN_MM + FOOT_MM
    size = _paper(paper, needed, board)
    left, top = (size[0] - width) / 2, (size[1] - FOOT_MM - height) / 2
    polygons = [_rectangle(left - 5, top - 5, width + 10, height + 10)] if board.inverted else []
    polygons += [Polygon(part.points + [left, top], part.white != board.inverted) for part in _pattern(board)]
    base, start = size[1] - MARGIN_MM, (size[0] - RULER_MM) / 2
    marks = [[(start + i, base), (start + i, base - (4.0 if i % 10 == 0 else 2.0))] for i in range(0, 101, 5)]
    lines = np.array([[(start, base), (start + RULER_MM, base)], *marks])
    text = f"Print at 100 %. This line must then measure 100 mm. {board}"[:90]
    return Page(size, tuple(polygons), lines, text, (start, base - 6.0))


def _paper(paper: str, needed: tuple[float, float], board: Board) -> tuple[float, float]:
    if paper == "fit":
        return needed
    by_name = {name.lower(): size for name, size in PAPERS.items()}
    if paper.lower() not in by_name:
        raise JobInvalid(f"Unknown paper size '{paper}'.", hint=f"Choose {', '.join(PAPERS)} or fit.")
    upright = by_name[paper.lower()]
    turned = upright[1], upright[0]
    for size in (upright, turned):
        if needed[0] <= size[0] and needed[1] <= size[1]:
            return size
    share = max(min(s[0] / needed[0], s[1] / needed[1]) for s in (upright, turned))
    message = f"The board needs {needed[0]:.0f} x {needed[1]:.0f} mm, but {paper} has {upright[0]:g} x {upright[1]:g}."
    hint = f"Use squares of {int(share * board.square_m * 1000)} mm, larger paper, or --paper fit for a print shop."
    raise JobInvalid(message, hint=hint)


def _pattern(board: Board) -> Iterator[Polygon]:
    side = 1000.0 * board.square_m
    if board.kind == "rings":
        angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        for centre in 1000.0 * board.points[:, :2] + side / 2:
            yield from (Polygon(centre + r * side / 2 * circle, bool(inner)) for inner, r in enumerate(RING))
        return
    for row, column in np.argwhere(np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2 == 0):
        yield _rectangle(column * side, row * side, side, side)
    if board.kind == "charuco":
        yield from _markers(board)


def _markers(board: Board) -> Iterator[Polygon]:
    made, aruco = charuco_boards(board)[0], opencv().aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, board.dictionary))
    modules = dictionary.markerSize + 2
    module = 1000.0 * board.marker_m / modules
    for number, quad in zip(np.ravel(made.getIds()), made.getObjPoints(), strict=True):
        left, top = 1000.0 * np.asarray(quad)[:, :2].min(axis=0)
        for row, bits in enumerate(aruco.generateImageMarker(dictionary, int(number), modules)):
            dark = np.flatnonzero(np.diff(np.concatenate([[0], bits < 128, [0]])))
            for start, stop in dark.reshape(-1, 2):
                yield _rectangle(left + start * module, top + row * module, (stop - start) * module, module)


def _rectangle(x: float, y: float, width: float, height: float) -> Polygon:
    return Polygon(np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]]))


POINTS_PER_MM = 72.0 / 25.4  # Number of PDF units (1/72 inch) per millimetre.
_THIN_MM, _TEXT_MM = 0.15, 2.8  # Width of a thin line, and text height, in mm. Chosen by hand.


def svg(page: Page) -> str:
    """Return the page as an SVG file in millimetres."""
    width, height = page.size
    shapes = []
    for part in page.polygons:
        points = " ".join(f"{x:.6g},{y:.6g}" for x, y in part.points)
        shapes.append(f'<polygon points="{points}" fill="{"white" if part.white else "black"}"/>')
    for (x1, y1), (x2, y2) in page.lines:
        ends = f'x1="{x1:.6g}" y1="{y1:.6g}" x2="{x2:.6g}" y2="{y2:.6g}"'
        shapes.append(f'<line {ends} stroke="black" stroke-width="{_THIN_MM}"/>')
    (x, y), font = page.text_place, f'font-family="Helvetica, Arial" font-size="{_TEXT_MM}"'
    shapes.append(f'<text x="{x:.6g}" y="{y:.6g}" {font}>{escape(page.text)}</text>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" shape-rendering="crispEdges">\n'
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>\n' + "\n".join(shapes) + "\n</svg>\n"
    )


def pdf(page: Page) -> bytes:
    """Return the page as a PDF 1.4 file. Millimetres with Y down are converted to PDF points with Y up.

    Reference: ISO 32000-1, 7.5 (file structure), 8.5 (paths).
    """
    width, height = (POINTS_PER_MM * length for length in page.size)
    drawing = ["q", f"{POINTS_PER_MM:.9f} 0 0 {-POINTS_PER_MM:.9f} 0 {height:.6f} cm", f"{_THIN_MM} w"]
    for part in page.polygons:
        (x, y), *rest = part.points
        path = [f"{x:.6f} {y:.6f} m", *(f"{a:.6f} {b:.6f} l" for a, b in rest), "h f"]
        drawing.append(f"{int(part.white)} g {' '.join(path)}")
    drawing += [f"0 G {x1:.6f} {y1:.6f} m {x2:.6f} {y2:.6f} l S" for (x1, y1), (x2, y2) in page.lines]
    (x, y), text = page.text_place, page.text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
    drawing.append(f"0 g BT /F1 {_TEXT_MM:g} Tf 1 0 0 -1 {x:.6f} {y:.6f} Tm ({text}) Tj ET")
    stream = "\n".join([*drawing, "Q"]).encode("latin-1", "replace")
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
