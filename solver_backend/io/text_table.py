"""Parse text tables: separators, decimal commas, missing cells, frame numbers and rates."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.plausible import USUAL_FRAME_RATES
from solver_backend.io.files import LARGEST_TAKE, as_text, first_bytes, read_text

MISSING = frozenset(("", "null", "none", "n/a", "na", "-", "--", "1.#qnan", "-1.#ind", "1.#ind", "-nan(ind)"))
"""Cells that mean no value. Spellings of NaN and spreadsheet errors (``#N/A``, ``#NV``) also mean no value."""
ROWS_LOOKED_AT = 100  # Number of rows read to find the number format.
_START_BYTES = 1 << 16  # Largest length of a table's first line in bytes, chosen by hand.
_GROUPED = re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d+")
"""A number with thousands separators, as spreadsheets write it: ``-1,779.458``."""
_EXCHANGED = str.maketrans(",.", ".,")
_MINUS = str.maketrans("\N{MINUS SIGN}", "-")
_GROUPS = re.compile(r"(?<=\d)[ '\N{RIGHT SINGLE QUOTATION MARK}\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}](?=\d{3})")
"""Thousands separators used in France and Switzerland: ``1 779,46``, ``1'779.46``."""
_WHOLE, _DIGITS = re.compile(r"[-+]?\d+"), re.compile(r"\d+")
OTHER_RATE = 0.3
"""Largest relative difference between the rate of a time column and the rate in the header. It is large because times
have few decimals, so that a step of 4 ms may appear as 0.00 or 0.01."""
_LEAST_STEP_S = 1e-9  # Smallest time step in seconds. No recording clock has a finer one.
LARGEST = 1e30  # Larger or infinite numbers count as missing, because no recorded value is that large.


def delimiter_of(line: str) -> str:
    """Return the most frequent separator in a line: a comma, a semicolon or a tab."""
    return max(",;\t", key=line.count)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Split a line into cells without surrounding spaces and quotes."""
    try:
        cells = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        cells = line.split(delimiter)
    return [cell.strip() for cell in cells]


def split_rows(lines: Iterable[str], delimiter: str) -> list[list[str]]:
    """Split each line into cells without surrounding quotes."""
    return [cells_of(line, delimiter) if '"' in line else line.split(delimiter) for line in lines]


def heading_of(path: Path) -> list[str]:
    """Read the cells in a table's first line, or no cells if the file is not a text table."""
    if path.suffix.lower() not in (".csv", ".tsv", ".txt"):
        return []
    start = first_bytes(path, _START_BYTES)
    # Decode whole lines, because a character cut off at the end would make UTF-8 look like another encoding.
    line = as_text(start[: start.rfind(b"\n") + 1] or start).partition("\n")[0]
    return cells_of(line, delimiter_of(line))


def csv_rows(text: str, delimiter: str, path: Path) -> list[list[str]]:
    """Split a table into its non-empty rows. Raise FileDamaged for invalid quotes."""
    try:
        return [row for row in csv.reader(io.StringIO(text), delimiter=delimiter) if row]
    except csv.Error as error:
        raise FileDamaged(f"The table cannot be read ({error}).", where=str(path)) from error


def read_rows(path: Path, largest: int = LARGEST_TAKE) -> tuple[list[str], list[list[str]]]:
    """Read a table's heading and rows. Raise FileMissing or FileDamaged."""
    text = read_text(path, largest)
    rows = csv_rows(text, delimiter_of(text.partition("\n")[0]), path)
    if not rows:
        raise FileDamaged("The table has no heading.", where=str(path))
    return [cell.strip() for cell in rows[0]], rows[1:]


def is_number(cell: str) -> bool:
    """Return whether a cell is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def read_numbers(
    rows: list[list[str]], first_line: int, path: Path, *, width: int = 0, leading: int = 1, sure: bool = True
) -> np.ndarray:
    """Convert the cells of rows to numbers (rows, columns). Missing cells are NaN.

    ``first_line`` is the line number of the first row, counted from 1, for messages. If the ``width`` of
    rows is known, decimals that were split at their commas are joined (see ``with_whole_decimals``).

    Raises:
        FileDamaged: a cell is not a number, or the row lengths differ too much for a table.
    """
    rows = with_whole_decimals(rows, width, leading, path, sure=sure) if width else rows
    comma = decimal_comma(cell for row in rows[:ROWS_LOOKED_AT] for cell in row)
    lengths = [_used(row) for row in rows]
    width = max(lengths, default=0)
    if len(rows) * width > 4 * sum(lengths) + 1_000_000:
        raise FileDamaged(f"The file is not a table. Its rows have {min(lengths)} to {width} cells.", where=str(path))
    values = np.full((len(rows), width), np.nan)
    for i, (row, length) in enumerate(zip(rows, lengths, strict=True)):
        try:
            values[i, :length] = [float(cell) if cell else np.nan for cell in row[:length]]
        except ValueError:
            values[i, :length] = [_number(cell, first_line + i, path, comma) for cell in row[:length]]
    values[~(np.abs(values) < LARGEST)] = np.nan
    return values


def _used(row: Sequence[str]) -> int:
    length = len(row)
    while length and not row[length - 1].strip():
        length -= 1
    return length


def _number(cell: str, line: int, path: Path, comma: bool) -> float:
    text = cell.strip().strip('"').lower()
    if text in MISSING or text.startswith("#"):
        return float("nan")
    text = _GROUPS.sub("", text.translate(_MINUS))
    text = text.translate(_EXCHANGED) if comma else text
    try:
        return float(text.replace(",", "") if _GROUPED.fullmatch(text) else text)
    except ValueError as error:
        hint = "Export the file again."
        raise FileDamaged(f"'{text[:40]}' is not a number.", where=f"{path}, line {line}", hint=hint) from error


def decimal_comma(cells: Iterable[str]) -> bool:
    """Return whether numbers have decimal commas: in every cell, the last comma or point is a comma."""
    last = {text[max(text.rfind(","), text.rfind("."))] for text in cells if "," in text or "." in text}
    return last == {","}


def between_tabs(lines: list[str], heading: str, least: int = 2) -> list[str]:
    """Replace a spreadsheet's separators by tabs, and remove quotes.

    The separator is the one that appears at least ``least`` times in ``heading``.
    """
    separator = next((mark for mark in ("\t", ";", ",", "|") if heading.count(mark) >= least), "\t")
    if separator == "\t" and '"' not in heading:
        return lines
    try:
        return ["\t".join(cells) for cells in csv.reader(lines, delimiter=separator)]
    except csv.Error:
        return lines


def with_whole_decimals(
    rows: list[list[str]], width: int, leading: int, path: Path, *, sure: bool = True
) -> list[list[str]]:
    """Join decimals that were split at their commas: ``12`` and ``50`` become ``12.50``.

    Rows have ``width`` cells. The first ``leading`` cells are not decimal numbers. If rows may have more cells
    (``sure`` is False), rows that cannot be joined are returned unchanged.

    Raises:
        FileDamaged: some rows are split, but others cannot be joined.
    """
    most = width + (width - leading) // 2
    split = (row for row in rows if most < _used(row) <= 2 * width)
    if not any(all(_WHOLE.fullmatch(c.strip()) or not c.strip() for c in row[leading:]) for row in split):
        return rows
    whole = [_joined(row, width, leading) for row in rows]
    if not all(whole):
        if not sure:
            return rows
        what = "Commas separate both cells and decimals, so the numbers are ambiguous."
        raise FileDamaged(what, where=str(path), hint="Save the table with semicolons or tabs between the cells.")
    return [row for row in whole if row is not None]


def _joined(row: Sequence[str], width: int, leading: int) -> list[str] | None:
    found, at = list(row[:leading]), leading
    while at < len(row) and len(found) < width:
        pair = [cell.strip() for cell in row[at : at + 2]]
        if not pair[0]:
            found.append("")
        elif len(pair) == 2 and _WHOLE.fullmatch(pair[0]) and _DIGITS.fullmatch(pair[1]):
            found.append(".".join(pair))
        else:
            return None
        at += 2 if pair[0] else 1
    return None if any(cell.strip() for cell in row[at:]) else found


def triples(values: np.ndarray, first_columns: Sequence[int]) -> np.ndarray:
    """Select positions (rows, M, 3) from the x column of each of M points. y and z are the next columns."""
    columns = np.asarray(first_columns, dtype=np.int64)[:, None] + np.arange(3)
    if columns.size and columns.max() >= values.shape[1]:
        more = columns.max() + 1 - values.shape[1]
        values = np.concatenate([values, np.full((len(values), more), np.nan)], axis=1)
    return values[:, columns]


def rate_of(times: np.ndarray) -> float | None:
    """Compute the frame rate from times in seconds, or return None if it is undefined.

    Times have few decimals. If the median step, or a mean step close to it, gives an integer rate within 1 in 10,000,
    return that integer. Otherwise, return the rate of the mean step, or of the median step if they differ by over 1 %.
    """
    times = times[np.isfinite(times)]
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else 0.0
    if not step > _LEAST_STEP_S:
        return None
    mean = float(times[-1] - times[0]) / len(steps)
    rates = [1.0 / s for s in (step, mean) if abs(s - step) < 0.01 * step]
    return next((float(round(rate)) for rate in rates if abs(rate - round(rate)) < 1e-4 * rate), rates[-1])


def _stated_rate(stated: float | None, times: np.ndarray) -> tuple[float | None, tuple[Diagnostic, ...]]:
    timed = rate_of(times)
    if stated is None or stated <= 0:
        return (timed if timed is not None else stated), ()
    if timed is None or abs(timed - stated) <= OTHER_RATE * stated:
        return stated, ()
    # A thinned file has new times and the old header. Times in another unit do not give a frame rate.
    least, most = USUAL_FRAME_RATES
    used = timed if least <= timed <= most else stated
    others = f"the header states {stated:g} and the times {timed:.4g}"
    return used, (diagnostic("marker_rates_contradict", rate=used, others=others),)


def different_count(items: str, stated: float | None, count: int) -> tuple[Diagnostic, ...]:
    """Report a header that states another number of items than the file contains."""
    if stated in (None, count):
        return ()
    return (diagnostic("count_not_as_stated", items=items, stated=f"{stated:g}", count=count),)


def frame_facts(
    numbers: np.ndarray | None, times: np.ndarray | None = None, rate: float | None = None, count: float | None = None
) -> tuple[float | None, tuple[Diagnostic, ...]]:
    """Return a table's frame rate, or None if it is unknown. Also report contradictions in the table.

    These are jumps in the frame numbers, times that contradict the rate, and a header with another frame count.
    ``numbers`` and ``times`` are (F,) columns or None. ``rate`` and the frame ``count`` come from the header.
    """
    rate, contradicted = (rate, ()) if times is None else _stated_rate(rate, times)
    if numbers is None:
        return rate, contradicted
    problems = list(different_count("frames", count, len(numbers)))
    if len(jumps := np.flatnonzero(np.diff(numbers) != 1)):
        at = int(jumps[0])
        before, after = (f"{number:g}" for number in numbers[at : at + 2])  # as text, because cells may be blank
        problems.append(diagnostic("frame_numbers_jump", before=before, after=after, jumps=len(jumps)))
    return rate, (*problems, *contradicted)


def number_in(cell: str | None) -> float | None:
    """Return the number in a cell, or None if the cell contains no number."""
    text = (cell or "").strip().strip('"').replace(",", ".")
    return float(text) if is_number(text) and np.isfinite(float(text)) else None
