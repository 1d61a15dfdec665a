"""The core of all readers of text tables: separators, decimal commas, blanks, words for missing, frames and rates.

A format describes where its header, rows and columns are. What is the same in all of them is here.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.recognition.range_checks import FRAME_RATES

MISSING = frozenset(("", "null", "none", "n/a", "na", "-", "--", "1.#qnan", "-1.#ind", "1.#ind", "-nan(ind)"))
"""Cells that stand for no value, beside every spelling of NaN and a spreadsheet's errors (``#N/A``, ``#NV``)."""

ROWS_LOOKED_AT = 100
"""Rows that show how numbers are written."""
_GROUPED = re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d+")
"""A number whose thousands are separated, as spreadsheets format them: ``-1,779.458``."""
_EXCHANGED = str.maketrans(",.", ".,")
_MINUS = str.maketrans("\N{MINUS SIGN}", "-")
_GROUPS = re.compile(r"(?<=\d)[ '\N{RIGHT SINGLE QUOTATION MARK}\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}](?=\d{3})")
"""What separates thousands in France and Switzerland: ``1 779,46``, ``1'779.46``."""
_WHOLE, _DIGITS = re.compile(r"[-+]?\d+"), re.compile(r"\d+")
OTHER_RATE = 0.3
"""Share by which the rate of a column of times differs from a stated one that it contradicts: times have few decimals,
and a step of 4 ms may be written as 0.00 or 0.01."""
LARGEST = 1e30
"""Numbers that are larger, or infinite, are missing: nothing in a recording is that large."""


def delimiter_of(line: str) -> str:
    """Return what separates a line's cells: a comma, a semicolon or a tab."""
    return max(",;\t", key=line.count)


def split_rows(lines: Iterable[str], delimiter: str) -> list[list[str]]:
    """Return the cells of lines, quotes around them removed."""
    return [header_cells(line, delimiter) if '"' in line else line.split(delimiter) for line in lines]


def header_cells(line: str, delimiter: str) -> list[str]:
    """Return a header line's cells without blanks and quotes around them."""
    try:
        cells = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        cells = line.split(delimiter)
    return [cell.strip() for cell in cells]


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
    """Return the numbers of a table whose decimals are written with points or commas, see ``number_table``.

    Args:
        rows: the cells of each row.
        first_line: the line of the first row, from 1, for messages.
        width: cells that a row should have, 0 where that is not known.
        leading: first cells without decimals, such as the frame's number.
        sure: see ``with_whole_decimals``.
    """
    rows = with_whole_decimals(rows, width, leading, path, sure=sure) if width else rows
    comma = decimal_comma(cell for row in rows[:ROWS_LOOKED_AT] for cell in row)
    return number_table(rows, first_line, path, comma=comma)


def number_table(rows: Sequence[Sequence[str]], first_line: int, path: Path, *, comma: bool = False) -> np.ndarray:
    """Return numbers of shape (rows, columns), NaN for blank and missing cells and for what shorter rows lack.

    Args:
        rows: the cells of each row.
        first_line: the line of the first row, from 1, for messages.
        comma: decimals are written with a comma.

    Raises:
        FileDamaged: a cell is no number, or rows differ so much in length that this is no table.
    """
    lengths = [_used(row) for row in rows]
    width = max(lengths, default=0)
    if len(rows) * width > 4 * sum(lengths) + 1_000_000:
        raise FileDamaged(f"The rows hold between {min(lengths)} and {width} cells: no table.", where=str(path))
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
    """Return whether numbers are written with a decimal comma, as half of the world does, points grouping thousands.

    The last of a cell's commas and points is the decimal one; where cells differ in that, a comma is damage.
    """
    last = {text[max(text.rfind(","), text.rfind("."))] for text in cells if "," in text or "." in text}
    return last == {","}


def between_tabs(lines: list[str], heading: str, least: int = 2) -> list[str]:
    """Return lines with tabs between cells, where a spreadsheet saved them with semicolons, commas or bars and quotes.

    Args:
        heading: the line that shows what stands between its cells.
        least: such marks that it has at least.
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
    """Return rows whose decimal commas were taken for separators of cells, whole again: ``12,50`` of two cells.

    Beside the first cells every value is two cells of digits, or a blank one where it is missing.

    Args:
        rows: of cells.
        width: cells that a row should have.
        leading: first cells that are no decimal numbers: the frame's, a name.
        sure: rows should have no further cells; else they may, and are left as they are where they cannot be put
            together.

    Raises:
        FileDamaged: some rows are so, and others cannot be put together.
    """
    most = width + (width - leading) // 2
    if not any(most < _used(row) <= 2 * width and _of_halves(row[leading:]) for row in rows):
        return rows
    whole = [_joined(row, width, leading) for row in rows]
    if not all(whole):
        if not sure:
            return rows
        what = "Commas separate both cells and decimals, and which are which cannot be recognised."
        raise FileDamaged(what, where=str(path), hint="Save the table with semicolons or tabs between the cells.")
    return [row for row in whole if row is not None]


def _of_halves(cells: Sequence[str]) -> bool:
    return all(_WHOLE.fullmatch(cell.strip()) or not cell.strip() for cell in cells)


def _joined(row: Sequence[str], width: int, leading: int) -> list[str] | None:
    """Return the first cells and values of two cells each, ``width`` in all; None where they are not so."""
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
    """Return positions (rows, markers, 3) whose x, y and z begin at these columns; columns that lack are NaN."""
    columns = np.asarray(first_columns, dtype=np.int64)[:, None] + np.arange(3)
    if columns.size and columns.max() >= values.shape[1]:
        more = columns.max() + 1 - values.shape[1]
        values = np.concatenate([values, np.full((len(values), more), np.nan)], axis=1)
    return values[:, columns]


def rate_of(times: np.ndarray) -> float | None:
    """Return the frames per second of a column of seconds, None where it gives none.

    Times have few decimals: where the median step, or the mean of all beside it, gives an integer within a part in
    10,000, it is that integer; else the mean knows more.
    """
    times = times[np.isfinite(times)]
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else 0.0
    if not step > 0:
        return None
    mean = float(times[-1] - times[0]) / len(steps)
    rates = [1.0 / s for s in (step, mean) if abs(s - step) < 0.01 * step]
    return next((float(round(rate)) for rate in rates if abs(rate - round(rate)) < 1e-4 * rate), rates[-1])


def stated_rate(stated: float | None, times: np.ndarray) -> tuple[float | None, tuple[Diagnostic, ...]]:
    """Return the frame rate of a file, and a diagnostic where its header and its column of times differ.

    Args:
        stated: frames a second that the header states, None where it does not.
        times: (F,) seconds; empty where the file has none.
    """
    timed = rate_of(times)
    if stated is None or stated <= 0:
        return (timed if timed is not None else stated), ()
    if timed is None or abs(timed - stated) <= OTHER_RATE * stated:
        return stated, ()
    # A file that was thinned out has new times and the old header; times in another unit give no frame rate.
    used = timed if FRAME_RATES[0] <= timed <= FRAME_RATES[1] else stated
    others = f"the header states {stated:g} and the times {timed:.4g}"
    return used, (diagnostic("marker_rates_contradict", rate=used, others=others),)


def frame_problems(numbers: np.ndarray, stated: float | None) -> tuple[Diagnostic, ...]:
    """Return what is wrong with the frames: their numbers jump, or are others than the file states.

    Args:
        numbers: (F,) the column of frame numbers.
        stated: how many frames the file states, None where it does not.
    """
    problems: list[Diagnostic] = []
    if stated is not None and stated != len(numbers):
        problems.append(diagnostic("count_not_as_stated", items="frames", stated=f"{stated:g}", count=len(numbers)))
    jumps = np.flatnonzero(np.diff(numbers) != 1)
    if len(jumps):
        at = int(jumps[0])
        before, after = (f"{number:g}" for number in numbers[at : at + 2])  # texts, as a blank cell is no number
        problems.append(diagnostic("frame_numbers_jump", before=before, after=after, jumps=len(jumps)))
    return tuple(problems)


@dataclass(frozen=True)
class FrameFacts:
    """What a table states about its frames."""

    first: int
    """The file's number of the first frame."""
    rate: float | None
    """Frames per second, None where neither header nor times give it."""
    problems: tuple[Diagnostic, ...]
    """Frame numbers, counts or times that contradict each other."""


def frame_facts(
    numbers: np.ndarray | None,
    times: np.ndarray | None = None,
    rate: float | None = None,
    count: float | None = None,
    first: int = 1,
) -> FrameFacts:
    """Return first frame and rate of a table.

    Args:
        numbers: (F,) column of frame numbers, None without one.
        times: (F,) column of seconds, None without one.
        rate: frames per second that the header states.
        count: number of frames that the header states.
        first: number of the first frame where the column does not give it.
    """
    rate, contradicted = (rate, ()) if times is None else stated_rate(rate, times)
    if numbers is None:
        return FrameFacts(first, rate, contradicted)
    known = len(numbers) > 0 and bool(np.isfinite(numbers[0]))
    return FrameFacts(int(numbers[0]) if known else first, rate, (*frame_problems(numbers, count), *contradicted))


def number_in(cell: str | None) -> float | None:
    """Return the number in a cell, None where it is none."""
    text = (cell or "").strip().strip('"').replace(",", ".")
    return float(text) if is_number(text) and np.isfinite(float(text)) else None
