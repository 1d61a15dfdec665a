"""Read 3D points from text tables and NumPy arrays."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.io.files import LARGEST_TEXT, LONGEST_HEADING, load_array, read_json, read_text
from solver_backend.io.markers.source import MarkerSource
from solver_backend.io.text_table import (
    cells_of,
    csv_rows,
    delimiter_of,
    frame_facts,
    read_numbers,
    triples,
    with_whole_decimals,
)
from solver_backend.types import JointSet

# Three layouts are supported. Wide with one heading row: ``frame, LASI_x, LASI_y, LASI_z, ...`` (also ``LASI.X``, or
# ``LASI X (mm)``). Wide with two rows: names above the first or each of the columns ``X, Y, Z``. Long with a row per
# point: ``frame, marker, x, y, z``. Other columns (anipose's ``LASI_error``, ``LASI_score``) are skipped.
LEAST_POINTS = 4  # Smallest number of points in a wide table. Fewer do not describe a person.
_HEADING_LINES = 12  # The headings must appear within this number of lines.
_COLUMN = re.compile(r"(?P<name>.*?)[ ._:\-\[(]*(?P<axis>[xyz])[\])]?(?: ?[\[(](?P<unit>\w+)[\])])?", re.IGNORECASE)
"""Headings such as ``LASI_x``, ``LASI.X``, ``LASI:X``, ``LASI[x]`` and ``LASI X (mm)``."""
_FRAMES = ("frame", "frames", "bild", "image", "frame#", "frame_number", "frame_id", "frame_idx", "fnum", "index", "")
_TIMES = ("time", "time (s)", "time (seconds)", "time_s", "timestamp", "timestamps", "seconds", "t", "zeit")
_TIMES += ("zeit (s)", "temps", "temps (s)")
_NAMES = ("marker", "name", "label", "keypoint", "landmark", "joint", "bodypart", "point", "marker_name")
"""Lower-case headings of the frame number, of the time in seconds, and of the point name in long tables."""


def begins_as_points(head: str) -> bool:
    """Return whether a file begins with the headings of a point table."""
    return _layout(head.splitlines()[:_HEADING_LINES]) is not None


def read_point_table(path: Path) -> MarkerSource:
    """Read the points in a text table. Raise FileMissing or FileDamaged."""
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    layout = _layout(lines[:_HEADING_LINES])
    if layout is None:
        what = "The table does not name its points: columns NAME_x, NAME_y, NAME_z are expected, or marker, x, y, z."
        raise FileDamaged(what, where=str(path), hint="Export it again with its headings.")
    first, headings, columns, stated = layout
    rows = csv_rows("\n".join(lines[first:]), delimiter_of(lines[first - 1]), path)
    leading = sum(heading in (*_FRAMES, *_NAMES) for heading in headings[:2])
    rows = with_whole_decimals(rows, len(headings), leading, path)
    if columns:
        kept = {x + k for x in columns.values() for k in range(3)}
        values = _numbers(rows, headings, kept, first, path)
        positions, labels = triples(values, list(columns.values())), tuple(columns)
    else:
        values, positions, labels = _from_long(rows, headings, first, path)
    numbers, times = (_column(values, headings, names) for names in (_FRAMES, _TIMES))
    rate, found = frame_facts(numbers, times)
    return MarkerSource(path, "Table of points", positions, labels, rate, "mm", "z", unit=stated, problems=found)


def _layout(lines: Sequence[str]) -> tuple[int, list[str], dict[str, int], str] | None:
    """Return the index of the first line with numbers, the headings, the first column of each point, and the unit.

    A long table, with one row per point and frame, has no columns for individual points. The result is None if the
    lines contain no point headings.
    """
    for at, line in enumerate(lines):
        cells = cells_of(line, delimiter_of(line))
        plain = [cell.lower() for cell in cells]
        if {"x", "y", "z"} <= set(plain) and set(plain) & set(_NAMES) and set(plain) & {*_FRAMES[:-1], *_TIMES}:
            return at + 1, plain, {}, ""
        above = cells_of(lines[at - 1], delimiter_of(lines[at - 1])) if at else []
        for names in (cells, _spread(above, plain)):
            columns, unit = _points(names)
            if len(columns) >= LEAST_POINTS:
                return at + 1, plain, columns, unit
    return None


def _spread(above: Sequence[str], axes: Sequence[str]) -> list[str]:
    """Combine two heading rows into one heading for each coordinate column, such as ``NAME_x``."""
    names, last = [], ""
    for column, axis in enumerate(axes):
        name = above[column] if column < len(above) else ""
        last = name if name or axis not in ("y", "z") else last
        names.append(f"{last}_{axis}" if axis in ("x", "y", "z") and last else "")
    return names


def _points(names: Sequence[str]) -> tuple[dict[str, int], str]:
    split = [_COLUMN.fullmatch(name) if len(name) <= LONGEST_HEADING else None for name in names]
    columns, unit = dict[str, int](), ""
    for x in range(len(names) - 2):
        parts = [part for part in split[x : x + 3] if part is not None and part["name"]]
        same = len({part["name"] for part in parts}) == 1
        if same and [part["axis"].lower() for part in parts] == ["x", "y", "z"]:
            columns.setdefault(parts[0]["name"], x)
            unit = unit or parts[0]["unit"] or ""
    return columns, unit


def _numbers(rows: list[list[str]], headings: Sequence[str], points: set[int], first: int, path: Path) -> np.ndarray:
    """Convert the point, frame and time columns to numbers. Other columns are NaN."""
    kept = points | {i for i, heading in enumerate(headings) if heading in (*_FRAMES, *_TIMES)}
    plain = [[cell if i in kept else "" for i, cell in enumerate(row)] for row in rows]
    return read_numbers(plain, first + 1, path)


def _column(values: np.ndarray, headings: Sequence[str], names: Sequence[str]) -> np.ndarray | None:
    """Return the column with the first matching heading, or None if it is missing or contains no numbers."""
    at = next((i for i, heading in enumerate(headings) if heading in names and i < values.shape[1]), None)
    return None if at is None or not np.isfinite(values[:, at]).any() else values[:, at]


def _from_long(
    rows: list[list[str]], headings: Sequence[str], first: int, path: Path
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Read a table with one row per point and frame. Return each frame's first row, positions (F, M, 3) and labels."""
    key = next(i for i, heading in enumerate(headings) if heading in _NAMES)
    names = [row[key].strip() if key < len(row) else "" for row in rows]
    axes = [headings.index(axis) for axis in "xyz"]
    values = _numbers(rows, headings, set(axes), first, path)
    values = np.pad(values, ((0, 0), (0, max(0, len(headings) - values.shape[1]))), constant_values=np.nan)
    moment = _column(values, headings, _FRAMES[:-1])
    moment = _column(values, headings, _TIMES) if moment is None else moment
    if moment is None:
        raise FileDamaged("The rows of the table have no frame number.", where=str(path), hint="Add a column 'frame'.")
    _, begins, frame = np.unique(moment, return_index=True, return_inverse=True)
    labels = tuple(dict.fromkeys(name for name in names if name))
    column = {label: i for i, label in enumerate(labels)}
    positions = np.full((len(begins), len(labels), 3), np.nan)
    named = [i for i, name in enumerate(names) if name]
    seen: set[tuple[int, str]] = set()
    for i in named:
        if (point := (int(frame[i]), names[i])) in seen:
            hint = "Write one table for each person, or camera, if there are several."
            what = f"'{names[i]}' occurs twice in one frame."
            raise FileDamaged(what, where=f"{path}, line {first + 1 + i}", hint=hint)
        seen.add(point)
    positions[frame[named], [column[names[i]] for i in named]] = values[np.ix_(named, axes)]
    return values[begins], positions, labels


def is_point_array(path: Path) -> bool:
    """Return whether a .npy file contains 3D points (F, N, 3).

    A damaged file counts too, so that ``read_point_array`` reports the damage.
    """
    if path.suffix.lower() != ".npy" or not path.is_file():
        return False
    try:
        array = load_array(path)
    except FileDamaged:
        return True  # the reader reports the damage
    return array.ndim == 3 and array.shape[-1] == 3


def read_point_array(path: Path) -> MarkerSource:
    """Read 3D points (F, N, 3), NaN where missing, and their N names.

    The names are in ``NAME.txt``, ``NAME.json``, ``names.txt`` or ``names.json`` next to ``NAME.npy``. A text file has
    one name per line, and a JSON file contains a list. Without a file of names, the points get the names of the only
    joint set with N points.

    Raises:
        FileDamaged: the file is not an array of numbers, or the number of names differs.
        FileMissing: there are no names.
    """
    array = load_array(path)
    if array.ndim != 3 or array.shape[-1] != 3 or array.dtype.kind not in "fiu":
        what = (
            f"The array contains {array.dtype} of shape {array.shape}, but numbers of (frames, points, 3) are expected."
        )
        raise FileDamaged(what, where=str(path), hint="Save the points of a single person.")
    names, note = _names(path, array.shape[1])
    positions = np.array(array, np.float64)
    return MarkerSource(path, "NumPy array", positions, names, None, "mm", "z", notes=(note,))


def _names(path: Path, count: int) -> tuple[tuple[str, ...], Diagnostic]:
    beside = [path.with_suffix(suffix) for suffix in (".txt", ".json")]
    found = next((p for p in (*beside, path.with_name("names.txt"), path.with_name("names.json")) if p.is_file()), None)
    if found is None:
        sets = [joint_set for joint_set in JointSet.fitting(count) if joint_set.num_keypoints == count]
        if len(sets) == 1:
            note = diagnostic("point_names_read", source="count", count=count, joint_set=sets[0].value)
            return sets[0].keypoints, note
        several = f" It might be {' or '.join(s.value for s in sets)}." if sets else ""
        hint = f"Write them to {path.stem}.txt next to it, one per line."
        raise FileMissing(f"The names of the array's {count} points are missing.{several}", where=str(path), hint=hint)
    if found.suffix == ".json":
        names = read_json(found)
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise FileDamaged("A list of names is expected.", where=str(found), hint='Write ["nose", "left_eye", ...].')
    else:
        lines = read_text(found, LARGEST_TEXT).replace(",", "\n").splitlines()
        names = [line.strip() for line in lines if line.strip()]
    if len(names) != count:
        what = f"The file contains {len(names)} names, but the array has {count} points."
        raise FileDamaged(what, where=str(found), hint="Write one name for each point, in the array's order.")
    return tuple(names), diagnostic("point_names_read", source="file", count=count, file=found.name)
