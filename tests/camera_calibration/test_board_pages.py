"""A printed board has its true size, and the detector finds on it what was drawn where it was drawn."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from solver_backend.camera_calibration.boards.board import Board, BoardDetector, board_named
from solver_backend.camera_calibration.boards.page import Page, board_page, pdf, svg
from solver_backend.camera_calibration.formats import board_toml
from solver_backend.exchange.errors import JobInvalid

cv2 = pytest.importorskip("cv2", reason="the extra capture is not installed")
BOARDS = ("charuco:5x7:35mm", "charuco:4x6:30mm:inverted", "checkerboard:8x5:30mm", "rings:4x11:36mm")
PX_PER_MM = 4.0


def rasterised(page: Page) -> np.ndarray:
    """Paint a page four times as large, where OpenCV's polygons reach half a pixel too far, and shrink it."""
    fine = 4 * PX_PER_MM
    picture = np.full([4 * round(PX_PER_MM * s) for s in page.size[::-1]], 255, np.uint8)
    for shape in page.polygons:
        corners = np.round((fine * shape.points - 0.5) * 256).astype(np.int32)
        cv2.fillPoly(picture, [corners], 255 if shape.white else 0, shift=8)
    return cv2.resize(picture, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("text", BOARDS)
def test_what_is_drawn_is_found_where_it_was_drawn(text: str) -> None:
    board = board_named(text)
    page = board_page(board)
    found = BoardDetector(board).find(rasterised(page))
    assert found is not None and not found.mirrored
    assert len(found.ids) == len(board.points)
    drawn = page.polygons[1 if board.inverted else 0].points  # the first ring, or the first square
    first = drawn.mean(axis=0) if board.kind == "rings" else drawn[2]
    expected = PX_PER_MM * (1000.0 * board.points[found.ids, :2] + first) - 0.5
    assert np.linalg.norm(found.px - expected, axis=1).max() < 0.3


def test_a_mirrored_board_is_named_mirrored() -> None:
    board = board_named(BOARDS[0])
    picture = rasterised(board_page(board))
    straight = BoardDetector(board).find(picture)
    found = BoardDetector(board).find(np.ascontiguousarray(picture[:, ::-1]))
    assert found is not None and straight is not None and found.mirrored
    expected = straight.px * [-1.0, 1.0] + [picture.shape[1] - 1.0, 0.0]
    assert np.linalg.norm(found.px - expected, axis=1).max() < 0.3


def test_a_blurred_board_is_less_sharp_and_a_tiny_one_is_not_taken() -> None:
    board = board_named(BOARDS[0])
    picture = rasterised(board_page(board))
    sharp, blurred = (BoardDetector(board).find(p) for p in (picture, cv2.GaussianBlur(picture, (0, 0), 3)))
    assert sharp is not None and blurred is not None
    assert blurred.sharpness < 0.3 * sharp.sharpness
    tiny = cv2.resize(picture, None, fx=0.05, fy=0.05, interpolation=cv2.INTER_AREA)
    assert BoardDetector(board).find(tiny) is None


def test_a_half_turned_checkerboard_keeps_its_first_corner() -> None:
    board = board_named(BOARDS[2])
    picture = rasterised(board_page(board))
    straight, turned = (BoardDetector(board).find(p) for p in (picture, np.ascontiguousarray(picture[::-1, ::-1])))
    assert straight is not None and turned is not None
    size = np.array(picture.shape[::-1]) - 1
    assert np.linalg.norm(turned.px - (size - straight.px), axis=1).max() < 0.6


@pytest.mark.parametrize("text", BOARDS)
def test_svg_and_pdf_have_the_true_size(text: str) -> None:
    board = board_named(text)
    page = board_page(board)
    root = ElementTree.fromstring(svg(page))
    assert root.get("width") == f"{page.size[0]:g}mm"
    assert root.get("viewBox") == f"0 0 {page.size[0]:g} {page.size[1]:g}"
    drawn = pdf(page)
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", drawn)
    assert box is not None
    assert float(box[1]) * 25.4 / 72 == pytest.approx(page.size[0], abs=1e-4)
    matrix = re.search(rb"([\d.]+) 0 0 -([\d.]+) 0 [\d.]+ cm", drawn)
    assert matrix is not None and float(matrix[1]) == pytest.approx(72 / 25.4, rel=1e-8)
    lines = re.findall(rb"0 G ([\d.]+) ([\d.]+) m ([\d.]+) ([\d.]+) l S", drawn)
    longest = max(abs(float(x2) - float(x1)) for x1, _, x2, _ in lines)
    assert longest == pytest.approx(100.0)
    if board.kind == "checkerboard":
        corners = re.findall(rb"0 g ([\d.]+) ([\d.]+) m ([\d.]+) ([\d.]+) l", drawn)
        assert {round(float(c[2]) - float(c[0]), 4) for c in corners} == {30.0}
    start = int(re.search(rb"startxref\n(\d+)", drawn)[1])
    assert drawn[start : start + 4] == b"xref"


def test_a_board_is_told_by_a_word_and_by_its_file(tmp_path) -> None:
    for text in BOARDS:
        path = tmp_path / "board.toml"
        path.write_text(board_toml(board_named(text)))
        assert board_named(str(path)) == board_named(text)
    for wrong, said in (
        ("charuco:5x7", "columns and rows"), ("dominoes:5x7:30mm", "Unknown board"), ("charuco:5x7:35mm:red", "'red'"),
        ("charuco:5x7:35", "'35'"), ("charuco:5x7:35mm:36mm", "does not fit"), ("checkerboard:5x7:35m", "not possible"),
    ):  # fmt: skip
        with pytest.raises(JobInvalid, match=said):
            board_named(wrong)
    assert not Board("checkerboard", 6, 8, 0.03).ends_differ
    with pytest.raises(JobInvalid, match="squares of"):
        board_page(board_named("charuco:5x7:80mm"), "A4")


@pytest.mark.parametrize("count", ["nan", "5.5", "1e300", '"five"', "[5]"])
def test_a_file_with_columns_that_are_no_count_is_refused(tmp_path, count) -> None:
    path = tmp_path / "board.toml"
    path.write_text(f'[board]\nkind = "checkerboard"\ncolumns = {count}\nrows = 7\nsquare_mm = 30.0\n')
    with pytest.raises(JobInvalid, match="3 to 50 columns"):
        board_named(str(path))
