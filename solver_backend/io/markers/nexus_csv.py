"""Markers in from CSV and text files of Vicon Nexus, and of Workstation and Polygon before it.

Source: the Vicon Nexus documentation, "Export ASCII files", and files of these programs. A file is made of sections
('Joints', 'Model Outputs', 'Devices', 'Events', 'Trajectories'), each its name, its rate ('100', or '100,Hz'), a row of
labels above the first of their three columns, a row 'Frame, Sub Frame, X, Y, Z, ...' ('Field #, X, Y, Z' in older
ones), in Nexus a row of units, then the frames until an empty line. Cells of a marker that is not seen are blank.
Vicon's world has Z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Severity, diagnostic
from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.io.camera_names import listing
from solver_backend.io.files import read_text
from solver_backend.io.markers.source import MarkerSource, left_out_note
from solver_backend.io.markers.text_table import (
    delimiter_of,
    frame_facts,
    header_cells,
    number_in,
    read_numbers,
    triples,
)
from solver_backend.io.recognition.marker_labels import is_model_output

SECTIONS = ("trajectories", "joints", "segments", "model outputs", "devices", "events")
"""What a file may hold; markers are in the first."""


def read_nexus_csv(path: Path) -> MarkerSource:
    """Read the trajectories of a CSV or text file of Nexus.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is truncated, is none of Nexus.
        NoDetections: it holds no trajectories but other sections, or no marker is ever seen.
    """
    lines = read_text(path).splitlines()
    sections = sections_of(lines)
    if "trajectories" not in sections:
        raise _no_trajectories(sections, path)
    delimiter, blocks = ",", []
    for start in _starts(lines, "trajectories"):
        delimiter, block = _block(lines, start, path)
        blocks.append(block)
    # Nexus writes one block; scripts that join exports write one per subject.
    same = [block for block in blocks if np.array_equal(block.numbers, blocks[0].numbers, equal_nan=True)]
    frames = frame_facts(blocks[0].numbers, rate=_rate(lines[sections["trajectories"] + 1], delimiter))
    count = len(blocks) - len(same)
    left = [diagnostic("parts_not_read", kind="blocks", severity=Severity.WARNING, count=count)] if count else []
    return MarkerSource(
        path=path,
        format="Nexus CSV",
        positions=np.concatenate([block.positions for block in same], axis=1),
        labels=tuple(label for block in same for label in block.labels),
        rate=frames.rate,
        default_unit="mm",
        default_up_axis="z",
        unit=blocks[0].unit,
        first_frame=frames.first,
        analog_channels=_devices(lines, sections, delimiter),
        notes=left_out_note(sum(block.outputs for block in same)),
        problems=(*frames.problems, *left),
    )


@dataclass(frozen=True)
class _TrajectoryBlock:
    """One section of trajectories."""

    numbers: np.ndarray
    """(F,) numbers of the frames."""
    positions: np.ndarray
    """(F, M, 3) in the file's unit."""
    labels: tuple[str, ...]
    unit: str
    """Empty where the file states none."""
    outputs: int
    """Points that are no positions."""


def _block(lines: Sequence[str], start: int, path: Path) -> tuple[str, _TrajectoryBlock]:
    at = next((i for i in range(start, min(start + 6, len(lines))) if _is_axes_row(lines[i])), None)
    if at is None:
        what = "The file is truncated: a row 'Frame,Sub Frame,X,Y,Z' is expected below 'Trajectories'."
        raise FileDamaged(what, where=str(path), hint="Export it again.")
    delimiter = delimiter_of(lines[at])
    axes, names = header_cells(lines[at], delimiter), header_cells(lines[at - 1], delimiter)
    points = {i: _cell(names, i) for i in range(len(axes) - 2) if axes[i : i + 3] == ["X", "Y", "Z"]}
    markers = {i: label for i, label in points.items() if not is_model_output(label)}
    units = header_cells(lines[at + 1], delimiter) if at + 1 < len(lines) else []
    has_units = bool(units) and not units[0]
    first = at + (2 if has_units else 1)
    values = read_numbers(_rows(lines[first:], delimiter), first + 1, path, width=len(axes), leading=2)
    return delimiter, _TrajectoryBlock(
        numbers=values[:, 0] if len(values) else np.zeros(0),
        positions=triples(values, tuple(markers)),
        labels=tuple(markers.values()),
        unit=next((cell for cell in units if cell), "") if has_units else "",
        outputs=len(points) - len(markers),
    )


def sections_of(lines: Sequence[str]) -> dict[str, int]:
    """Return the line of each section by its name in small letters."""
    found: dict[str, int] = {}
    for i, line in enumerate(lines):
        if name := _section(line):
            found.setdefault(name, i)
    return found


def _section(line: str) -> str:
    name = line.strip(' ,;\t"').lower() if len(line) < 200 else ""
    return name if name in SECTIONS else ""


def _starts(lines: Sequence[str], name: str) -> list[int]:
    return [i for i, line in enumerate(lines) if _section(line) == name]


def _no_trajectories(sections: dict[str, int], path: Path) -> Exception:
    if not sections:
        what = f"The file is not one of Nexus: one of {listing(SECTIONS)} is expected on a line of its own."
        return FileDamaged(what, where=str(path), hint="Export it again.")
    hint = "Export it with 'Trajectories' switched on."
    return NoDetections(f"The file holds no markers but {listing(sections)}.", where=str(path), hint=hint)


def _cell(cells: Sequence[str], index: int) -> str:
    return cells[index] if index < len(cells) else ""


def _is_axes_row(line: str) -> bool:
    return line.strip(' "').lower().startswith(("frame", "field #"))


def _rate(line: str, delimiter: str) -> float | None:
    return number_in(next(iter(header_cells(line, delimiter)), None))


def _rows(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    rows: list[list[str]] = []
    for line in lines:
        cells = header_cells(line, delimiter) if '"' in line else line.split(delimiter)
        if not cells[0].strip() or _section(line):
            break
        rows.append(cells)
    return rows


def _devices(lines: Sequence[str], sections: dict[str, int], delimiter: str) -> tuple[str, ...]:
    start = sections.get("devices", len(lines))
    at = next((i for i in range(start, min(start + 6, len(lines))) if _is_axes_row(lines[i])), None)
    return tuple(cell for cell in header_cells(lines[at], delimiter)[2:] if cell) if at is not None else ()
