"""Describe a calibration board: kind, points in metres, short name and file."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import JobInvalid
from solver_backend.io.files import read_toml
from solver_backend.types.shapes import Float

KINDS = ("charuco", "checkerboard", "rings")
DEFAULT_DICTIONARY = "DICT_4X4_100"
MARKER_SHARE = 0.75
"""Side of a marker in squares, where it is not given."""
EXAMPLE = "charuco:5x7:35mm, checkerboard:8x5:60mm, rings:4x11:40mm, or a board.toml"
_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
"""Metres in each unit that a board's square may have."""
_LENGTH = re.compile(r"(\d+(?:\.\d+)?)(mm|cm|m|in)")


@dataclass(frozen=True)
class Board:
    """A flat board. Its first point lies at the origin, X to the right, Y down, as one looks at it."""

    kind: str
    columns: int
    """Squares from left to right. Of rings: rings in a row."""
    rows: int
    """Squares from top to bottom. Of rings: rows, every other one shifted by half a distance."""
    square_m: float
    """Side of a square. Of rings: distance of two in a row."""
    marker_m: float = 0.0
    dictionary: str = DEFAULT_DICTIONARY
    """OpenCV's name of the Charuco board's marker dictionary."""
    inverted: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise JobInvalid(
                f"There is no board '{self.kind}'; known are {', '.join(KINDS)}.", hint=f"Write {EXAMPLE}."
            )
        if not all(isinstance(count, int) and 3 <= count <= 50 for count in (self.columns, self.rows)):
            raise JobInvalid(f"A board has 3 to 50 columns and rows, not {self.columns} x {self.rows}.")
        if not 0.001 <= self.square_m <= 2.0:
            raise JobInvalid(
                f"A square of {self.square_m * 1000:g} mm is impossible; the side of one square is 1 mm to 2 m."
            )
        if self.kind == "charuco" and not 0.3 * self.square_m <= self.marker_m < self.square_m:
            raise JobInvalid(
                f"A marker of {self.marker_m * 1000:g} mm does not fit a square of {self.square_m * 1000:g} mm."
            )

    @property
    def points(self) -> Float[np.ndarray, "points 3"]:
        """(N, 3) metres: inner corners row by row, or centres of rings. Z is 0."""
        if self.kind == "rings":
            row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
            x, y = (2 * column + row % 2) * self.square_m / 2, row * self.square_m / 2
        else:
            row, column = np.divmod(np.arange((self.columns - 1) * (self.rows - 1)), self.columns - 1)
            x, y = column * self.square_m, row * self.square_m
        return np.stack([x, y, np.zeros(len(x))], axis=-1)

    @property
    def ends_differ(self) -> bool:
        """Return whether the board half turned looks different, so that several cameras agree which end is which."""
        return self.kind == "charuco" or (self.columns + self.rows) % 2 == 1

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the pattern."""
        if self.kind == "rings":
            return (self.columns + 0.5) * self.square_m, (self.rows + 1) * self.square_m / 2
        return self.columns * self.square_m, self.rows * self.square_m

    def __str__(self) -> str:
        unit = "rings apart" if self.kind == "rings" else "squares"
        return f"{self.kind} of {self.columns} x {self.rows}, {unit} {self.square_m * 1000:g} mm"


def board_named(text: str) -> Board:
    """Return the board of a word such as ``charuco:5x7:35mm`` or of a TOML file.

    Fields after the kind, in any order: columns x rows, the square's side, then the marker's side, a dictionary's name,
    ``inverted``.

    Raises:
        JobInvalid: a field is unknown or missing, or the board is impossible.
    """
    if text.lower().endswith(".toml"):
        return _from_table(read_toml(Path(text)), text)
    kind, *fields = text.split(":")
    counts: tuple[int, int] | None = None
    lengths: list[float] = []
    other: dict[str, Any] = {}
    for field in fields:
        length, count = _LENGTH.fullmatch(field.lower()), re.fullmatch(r"(\d+)[xX](\d+)", field)
        if length:
            lengths.append(round(float(length[1]) * _UNITS[length[2]], 9))
        elif count:
            counts = int(count[1]), int(count[2])
        elif field.upper().startswith("DICT_"):
            other["dictionary"] = field.upper()
        elif field.lower() == "inverted":
            other["inverted"] = True
        else:
            raise JobInvalid(f"'{field}' is not a property of a board.", where=text, hint=f"Write {EXAMPLE}.")
    if counts is None or not lengths:
        raise JobInvalid("A board needs columns x rows and the side of a square.", where=text, hint=f"Write {EXAMPLE}.")
    marker = lengths[1] if len(lengths) > 1 else round(MARKER_SHARE * lengths[0], 9)
    return Board(kind.lower(), *counts, lengths[0], marker if kind.lower() == "charuco" else 0.0, **other)


def _from_table(table: dict[str, Any], where: str) -> Board:
    """Return the board of our own file, or of caliscope's ``charuco.toml``."""
    try:
        if "board" in table:
            given = dict(table["board"])
            square, marker = given.pop("square_mm") / 1000.0, given.pop("marker_mm", 0.0) / 1000.0
            return Board(square_m=square, marker_m=marker, **given)
        charuco = table.get("charuco", table)
        square = float(charuco["square_size_override_cm"]) / 100.0
        board = Board("charuco", charuco["columns"], charuco["rows"], square, square * charuco["aruco_scale"])
        return replace(board, dictionary=charuco["dictionary"], inverted=bool(charuco["inverted"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise JobInvalid(
            f"The file does not describe a whole board ({error}).", where=where, hint=f"Write {EXAMPLE}."
        ) from error


def board_toml(board: Board) -> str:
    """Return the board as the text of a TOML file, which ``board_named`` reads."""
    lines = [
        "[board]",
        f'kind = "{board.kind}"',
        f"columns = {board.columns}",
        f"rows = {board.rows}",
        f"square_mm = {board.square_m * 1000:.6g}",
    ]
    if board.kind == "charuco":
        lines += [f"marker_mm = {board.marker_m * 1000:.6g}", f'dictionary = "{board.dictionary}"']
    return "\n".join([*lines, f"inverted = {str(board.inverted).lower()}", ""])
