"""A page as SVG and as PDF at true scale, written by hand: one page, one font, black and white."""

from __future__ import annotations

from xml.sax.saxutils import escape

from solver_backend.camera_calibration.boards.page import Disc, Page, PageLine, Polygon, Shape

POINTS_PER_MM = 72.0 / 25.4
_KAPPA = 0.5522847498
"""Bézier handles of a quarter circle, in radii."""
_THIN_MM = 0.15
"""Width of a thin line, millimetres; chosen by hand."""


def svg(page: Page) -> str:
    """Return the page as SVG whose units are millimetres."""
    width, height = page.size
    shapes = "\n".join(_svg_shape(shape) for shape in page.shapes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" shape-rendering="crispEdges">\n'
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>\n{shapes}\n</svg>\n'
    )


def _svg_shape(shape: Shape) -> str:
    if isinstance(shape, Polygon):
        points = " ".join(f"{x:.6g},{y:.6g}" for x, y in shape.points)
        return f'<polygon points="{points}" fill="{_colour(shape.white)}"/>'
    if isinstance(shape, Disc):
        x, y = shape.centre
        return f'<circle cx="{x:.6g}" cy="{y:.6g}" r="{shape.radius:.6g}" fill="{_colour(shape.white)}"/>'
    if isinstance(shape, PageLine):
        (x1, y1), (x2, y2) = shape.start, shape.end
        return (
            f'<line x1="{x1:.6g}" y1="{y1:.6g}" x2="{x2:.6g}" y2="{y2:.6g}" stroke="black" stroke-width="{_THIN_MM}"/>'
        )
    x, y = shape.place
    font = f'font-family="Helvetica, Arial" font-size="{shape.size}"'
    return f'<text x="{x:.6g}" y="{y:.6g}" {font}>{escape(shape.text)}</text>'


def _colour(white: bool) -> str:
    return "white" if white else "black"


def pdf(page: Page) -> bytes:
    """Return the page as PDF 1.4: lengths are points of 1/72 inch, Y up, so a matrix turns millimetres into them.

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
    if isinstance(shape, Polygon):
        (x, y), *rest = shape.points
        path = [f"{x:.6f} {y:.6f} m", *(f"{a:.6f} {b:.6f} l" for a, b in rest), "h f"]
        return f"{_grey(shape.white)} " + " ".join(path)
    if isinstance(shape, Disc):
        return f"{_grey(shape.white)} {_circle(*shape.centre, shape.radius)} f"
    if isinstance(shape, PageLine):
        (x1, y1), (x2, y2) = shape.start, shape.end
        return f"0 G {x1:.6f} {y1:.6f} m {x2:.6f} {y2:.6f} l S"
    x, y = shape.place
    text = shape.text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
    return f"0 g BT /F1 {shape.size:g} Tf 1 0 0 -1 {x:.6f} {y:.6f} Tm ({text}) Tj ET"


def _grey(white: bool) -> str:
    return "1 g" if white else "0 g"


def _circle(x: float, y: float, r: float) -> str:
    k = _KAPPA * r
    quarters = [
        ((r, k), (k, r), (0, r)),
        ((-k, r), (-r, k), (-r, 0)),
        ((-r, -k), (-k, -r), (0, -r)),
        ((k, -r), (r, -k), (r, 0)),
    ]  # fmt: skip
    curves = [" ".join(f"{x + a:.6f} {y + b:.6f}" for a, b in q) + " c" for q in quarters]
    return f"{x + r:.6f} {y:.6f} m " + " ".join(curves)
