"""Tables with a heading row whose columns are a point's x, y and score: SLEAP's CSV, and tables people make."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.regular_file import open_regular
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.detections.deeplabcut import frames_of_columns
from solver_backend.io.files import read_text

_COLUMN = re.compile(
    r"(?P<name>.*\w)[ ._-]+(?P<coord>x|y|z|score|confidence|conf|likelihood|visibility|prob|c|p|v)", re.I
)
"""``nose.x``, ``left_knee_y``, ``left knee confidence``."""
_FRAMES = ("frame", "frame_idx", "frame_index", "frame_number", "frame_id", "index", "")
_PEOPLE = ("track", "person", "person_id", "individual", "id")
"""Headings of the frame's number and of the person, in small letters."""
LEAST_POINTS = 8
"""Points with x and y that a table of a body has at least."""
_START_BYTES = 1 << 16


def is_table(path: Path) -> bool:
    """Whether a file begins with such a heading row; positions in space, with z and no score, are none."""
    if path.suffix.lower() not in (".csv", ".tsv", ".txt"):
        return False
    try:
        with open_regular(path) as file:
            first = file.read(_START_BYTES).decode("utf-8-sig", "replace").partition("\n")[0]
    except OSError:
        return False
    columns = _points(_cells(first)[0])
    whole = [coords for coords in columns.values() if {"x", "y"} <= coords.keys()]
    return len(whole) >= LEAST_POINTS and not any("z" in coords and "likelihood" not in coords for coords in whole)


def read_table(path: Path) -> CameraFrames:
    """Return the frames of one camera; a point without a score is sure where it is there.

    Raises:
        FileDamaged: a row is short, or a value is no number.
    """
    text = read_text(path).lstrip("\ufeff")
    try:
        heading, *rows = [row for row in csv.reader(io.StringIO(text), delimiter=_separator(text)) if row]
    except (csv.Error, ValueError) as error:
        raise FileDamaged(f"The table cannot be read ({error}).", where=str(path)) from error
    plain = [name.strip().lower() for name in heading]
    points = _points(heading)
    names = [name for name, coords in points.items() if {"x", "y"} <= coords.keys()]
    frame = next((plain.index(name) for name in _FRAMES if name in plain), None)
    person = next((plain.index(name) for name in _PEOPLE if name in plain), None)
    try:
        numbers = [row if frame is None else int(float(cells[frame])) for row, cells in enumerate(rows)]
        who = ["" if person is None else cells[person].strip() for cells in rows]
        values = np.array(
            [[float(cells[points[n][c]].strip() or "nan") if c in points[n] else 1.0 for n in names for c in _COORDS]
             for cells in rows]
        ).reshape(len(rows), len(names), 3)  # fmt: skip
    except (ValueError, IndexError, OverflowError) as error:
        raise FileDamaged(f"A row is short or holds what is no number ({error}).", where=str(path)) from error
    values[..., 2] = np.where(np.isfinite(values[..., :2]).all(-1), values[..., 2], 0.0)
    return _frames(numbers, who, values, names, path)


_COORDS = ("x", "y", "likelihood")


def _frames(numbers: list[int], who: list[str], values: np.ndarray, names: list[str], path: Path) -> CameraFrames:
    """Return the frames of rows, of which each is one person in one frame."""
    people = list(dict.fromkeys(who))
    frames = sorted(set(numbers))
    row_of = {number: row for row, number in enumerate(frames)}
    table = np.full((len(frames), len(people), len(names), 3), np.nan)
    for number, person, points in zip(numbers, who, values, strict=True):
        table[row_of[number], people.index(person)] = points
    columns = [(person, name, coord) for person in people for name in names for coord in _COORDS]
    persons, parts, coords = (list(column) for column in zip(*columns, strict=True))
    return frames_of_columns(frames, table.reshape(len(frames), -1), persons, parts, coords, path)


def _separator(text: str) -> str:
    return max(",;\t", key=text.partition("\n")[0].count)


def _cells(line: str) -> list[list[str]]:
    return list(csv.reader([line], delimiter=_separator(line))) or [[]]


def _points(heading: list[str]) -> dict[str, dict[str, int]]:
    """Return the column of each coordinate of each point."""
    points: dict[str, dict[str, int]] = {}
    for column, name in enumerate(heading):
        if found := _COLUMN.fullmatch(name.strip()):
            coord = found["coord"].lower()
            points.setdefault(found["name"], {}).setdefault(coord if coord in "xyz" else "likelihood", column)
    return points
