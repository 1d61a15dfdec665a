"""Tables of gloves: a line of headings, a row a frame."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, MotionInvalid
from solver_backend.io.files import LONGEST_HEADING, read_text
from solver_backend.io.markers.text_table import decimal_comma, header_cells, number_table

_LARGEST = 512_000_000
"""Bytes of a table."""
_LEAST_FRAMES = 2
"""Without two no frame rate is known."""


def headings(path: Path) -> tuple[list[str], str]:
    """Return the headings of a table and what separates its cells.

    Raises:
        FileMissing, FileDamaged: see ``read_text``.
    """
    line = read_text(path, _LARGEST).lstrip("\ufeff").partition("\n")[0]
    delimiter = max(",;\t", key=line.count)
    return [cell[:LONGEST_HEADING] for cell in header_cells(line.rstrip("\r"), delimiter)], delimiter


def read_columns(path: Path, wanted: Callable[[str], bool]) -> dict[str, np.ndarray]:
    """Return (F,) numbers by heading of the columns that are wanted, NaN where cells are blank.

    Raises:
        FileMissing, FileDamaged: the file is not there, has no frames, or a cell is no number.
    """
    names, delimiter = headings(path)
    kept = [(k, name) for k, name in enumerate(names) if wanted(name)]
    lines = read_text(path, _LARGEST).splitlines()[1:]
    try:
        rows = [row for row in csv.reader(lines, delimiter=delimiter) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise FileDamaged(f"The table cannot be read: {error}.", where=str(path)) from error
    if len(rows) < _LEAST_FRAMES:
        raise FileDamaged(f"The table has {len(rows)} frames; {_LEAST_FRAMES} are the least.", where=str(path))
    chosen = [[row[k] if k < len(row) else "" for k, _ in kept] for row in rows]
    comma = delimiter != "," and decimal_comma(cell for row in chosen[:100] for cell in row)
    values = number_table(chosen, 2, path, comma=comma)
    values = np.pad(values, ((0, 0), (0, max(0, len(kept) - values.shape[1]))), constant_values=np.nan)
    return {name: values[:, column] for column, (_, name) in enumerate(kept)}


def rising_times(times: np.ndarray, path: Path) -> np.ndarray:
    """Return (F,) seconds from the first frame of a column in milliseconds.

    Raises:
        MotionInvalid: they do not rise.
    """
    seconds = (times - times[0]) / 1000.0
    if not np.isfinite(seconds).all() or (np.diff(seconds) <= 0).any():
        raise MotionInvalid("The times of the frames do not rise.", where=str(path), hint="Export the table again.")
    return seconds
