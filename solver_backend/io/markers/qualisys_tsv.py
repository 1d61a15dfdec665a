"""Markers in from TSV files of Qualisys Track Manager.

Source: the QTM user manual, "TSV file formats, motion data". Lines of a name and its values between tabs (NO_OF_FRAMES,
NO_OF_MARKERS, FREQUENCY, DATA_INCLUDED, EVENT, MARKER_NAMES, TRAJECTORY_TYPES), on demand a row of column names, then
the frames: on demand a frame number and a time, then x, y and z of every marker in millimetres. A marker that is not
seen is blank, 'null' or 0. QTM's world has Z up unless changed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged
from solver_backend.io.files import read_text
from solver_backend.io.markers.qualisys_bodies import ENDING, bodies_file, qualisys_bodies
from solver_backend.io.markers.rigid_bodies import RigidBodies
from solver_backend.io.markers.source import MarkerSource, as_take
from solver_backend.io.markers.take import MarkerEvent, MarkerTake
from solver_backend.io.markers.text_table import (
    ROWS_LOOKED_AT,
    between_tabs,
    decimal_comma,
    frame_problems,
    number_in,
    number_table,
    stated_rate,
    triples,
    with_whole_decimals,
)

FIRST_LINE = "NO_OF_FRAMES"
"""How the files begin."""


def read_qualisys_tsv(
    path: Path | str, *, fps: float | None = None, unit: str | None = None, up_axis: str | None = None
) -> MarkerTake:
    """Read the markers of a TSV file of QTM.

    Args:
        path: the file.
        fps: frames per second; None takes what the file states.
        unit: its length unit; None takes mm, or estimates it from the markers' spread.
        up_axis: its axis that points up; None takes Z, or how the body stands.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is truncated, is none of QTM, or states no frame rate.
        CaptureNotRecognised: it holds 2D or 6D data.
        NoDetections: it holds no markers, or none is ever seen.
        JobInvalid: the rate, unit or axis that is given is impossible.
    """
    path = Path(path)
    lines = _lines(path)
    if not lines or not lines[0].strip().upper().startswith(FIRST_LINE):
        raise FileDamaged(f"The file is not one of QTM: '{FIRST_LINE}' is expected at its start.", where=str(path))
    first = next((i for i, line in enumerate(lines) if _starts_with_number(line)), len(lines))
    header, events = _header(lines[:first])
    included = " ".join(header.get("DATA_INCLUDED", ["3D"]))
    if included.strip() and "3D" not in included.upper():
        beside = f" Poses of rigid bodies become props: keep the file beside that of the markers, as take{ENDING}.tsv."
        raise CaptureNotRecognised(
            f"The file holds {included} data; markers are 3D.", where=str(path),
            hint=f"Export 3D data.{beside if '6D' in included.upper() else ''}",
        )  # fmt: skip
    labels = [name for name in header.get("MARKER_NAMES", []) if name]
    timed = 2 if "FRAME" in header else 0
    values = _numbers(lines, first, path, timed + 3 * len(labels), timed // 2)
    stated = number_in(" ".join(header.get("NO_OF_MARKERS", [])))
    count = len(labels) or int(min(max(stated or 0, 0), values.shape[1] // 3))
    before = 2 if "FRAME" in header or _has_frame_columns(values, count) else 0
    numbers = values[:, 0] if before else np.arange(1.0, len(values) + 1)
    times = values[:, 1] if before else np.zeros(0)
    rate, contradicted = stated_rate(number_in(" ".join(header.get("FREQUENCY", []))), times)
    problems: tuple[Diagnostic, ...] = ()
    if stated not in (None, count):
        problems = (diagnostic("marker_names_not_as_stated", stated=stated, count=count),)
    frames = number_in(" ".join(header.get(FIRST_LINE, [])))
    source = MarkerSource(
        path=path,
        format="Qualisys TSV",
        positions=triples(values, range(before, before + 3 * count, 3)),
        labels=(*labels, *[""] * (count - len(labels))),
        rate=rate,
        default_unit="mm",
        default_up_axis="z",
        first_frame=int(numbers[0]) if len(numbers) and np.isfinite(numbers[0]) else 1,
        events=events,
        bodies=_bodies_beside(path, len(values)),
        problems=(*problems, *frame_problems(numbers, frames), *contradicted),
    )
    return as_take(source, fps=fps, unit=unit, up_axis=up_axis)


def _bodies_beside(path: Path, frames: int) -> RigidBodies | None:
    """Return the rigid bodies of the file of 6D data beside a file of markers."""
    beside = bodies_file(path)
    if beside is None:
        return None
    lines = _lines(beside)
    first = next((i for i, line in enumerate(lines) if _starts_with_number(line)), len(lines))
    return qualisys_bodies(_header(lines[:first])[0], _numbers(lines, first, beside), frames)


def _lines(path: Path) -> list[str]:
    """Return a file's lines with tabs between cells, also where a spreadsheet saved it with semicolons or commas."""
    lines = read_text(path).splitlines()
    return between_tabs(lines, lines[0] if lines else "", least=1)


def _numbers(lines: list[str], first: int, path: Path, width: int = 0, leading: int = 0) -> np.ndarray:
    """Return the numbers of the frames, which begin at a line.

    Args:
        lines: of the file.
        first: line of the first frame.
        path: the file.
        width: cells that a row should have, 0 where nobody knows.
        leading: of these, first ones without decimals.
    """
    rows = [line.split("\t") for line in lines[first:] if line.strip()]
    rows = with_whole_decimals(rows, width, leading, path) if width else rows
    comma = decimal_comma(cell for row in rows[:ROWS_LOOKED_AT] for cell in row)
    return number_table(rows, first + 1, path, comma=comma)


def _starts_with_number(line: str) -> bool:
    """Return whether a line is a frame: a first cell that is a number, or blank cells before one."""
    cells = [cell for cell in line.split("\t") if cell.strip()]
    return bool(cells) and number_in(cells[0]) is not None


def _header(lines: list[str]) -> tuple[dict[str, list[str]], tuple[MarkerEvent, ...]]:
    """Return the values of every name, and the events: EVENT, label, frame, time."""
    header: dict[str, list[str]] = {}
    events: list[MarkerEvent] = []
    for line in lines:
        name, *cells = (cell.strip() for cell in line.split("\t"))
        if name.upper() == "EVENT" and len(cells) >= 3 and (time := number_in(cells[2])) is not None:
            events.append(MarkerEvent(cells[0], time))
        else:
            header.setdefault(name.upper(), cells)
    return header, tuple(events)


def _has_frame_columns(values: np.ndarray, markers: int) -> bool:
    """Return whether a frame number and a time stand before the markers: numbers that go on by one, then time."""
    if values.shape[1] < 2 or not len(values):
        return False
    if values.shape[1] == 3 * markers + 2:
        return True
    steps = np.diff(values[:, :2], axis=0)
    return bool(len(steps) and values.shape[1] != 3 * markers and (steps[:, 0] == 1).all() and (steps[:, 1] > 0).all())
