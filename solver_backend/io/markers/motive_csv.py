"""Markers in from CSV files of OptiTrack Motive (format versions 1.2 to 1.25).

Source: the OptiTrack documentation, "Data Export: CSV". The first line holds names and values in turn ('Format
Version', 'Capture Frame Rate', 'Rotation Type', 'Length Units', ...). Then come rows of types, names, ids (and parents,
in newer versions), of quantities ('Rotation', 'Position', 'Mean Marker Error'), and the row 'Frame', 'Time (Seconds)',
in some versions 'TimeCode', X, Y, Z, W. Which rows there are depends on the version, so columns are found by what is
in them. Cells of a marker that is not seen are blank. Motive's world has Y up.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import FileDamaged, NoDetections
from solver_backend.exchange.so3 import matrix_from_quat
from solver_backend.io.files import read_text
from solver_backend.io.markers.source import MarkerSource, RigidBodies
from solver_backend.io.markers.text_table import (
    delimiter_of,
    frame_facts,
    header_cells,
    number_in,
    read_numbers,
    split_rows,
    triples,
)
from solver_backend.io.recognition.marker_labels import prefix_of

_TYPE, _TURN, _PLACE = "rigid body", "rotation", "position"


@dataclass(frozen=True)
class BodyColumns:
    """Where rigid bodies stand in a table."""

    names: tuple[str, ...]
    """One a body."""
    turns: tuple[int, ...]
    """First column of each quaternion, X, Y, Z, W."""
    places: tuple[int, ...]
    """First column of each position."""

    def poses(self, values: np.ndarray) -> RigidBodies:
        """Return the bodies of a table of F rows; one without a quaternion in a row is not seen there."""
        places = triples(values, list(self.places))
        quat = np.stack([values[:, [turn + 3, turn, turn + 1, turn + 2]] for turn in self.turns], axis=1)
        length = np.linalg.norm(quat, axis=-1, keepdims=True)
        good = np.isfinite(length) & (length > 0.5)
        rotations = matrix_from_quat(np.where(good, quat, (1.0, 0.0, 0.0, 0.0)) / np.where(good, length, 1.0))
        return RigidBodies(self.names, np.where(good, places, np.nan), rotations)


def motive_bodies(
    header: Sequence[Sequence[str]], labels: Sequence[str], rotation_type: str
) -> tuple[BodyColumns | None, tuple[Diagnostic, ...]]:
    """Return the rigid bodies whose markers a file does not hold, and notes on all of them.

    Args:
        header: rows from the types to 'Frame', 'Time (Seconds)', ...
        labels: of the file's markers.
        rotation_type: as the file states it; Euler angles are not read.
    """
    at = next((i for i, row in enumerate(header) if any(cell.lower() == _TYPE for cell in row)), None)
    if at is None:
        return None, ()
    axes = header[-1]
    types, names, quantities = (
        [*row, *[""] * len(axes)][: len(axes)] for row in (header[at], header[at + 1], header[-2])
    )
    of_body = [i for i in range(len(axes)) if types[i].lower() == _TYPE]
    found = dict.fromkeys(names[i] for i in of_body)
    first = [i for i in reversed(of_body) if axes[i].upper() == "X" and quantities[i].lower() in (_TURN, _PLACE)]
    starts = {(names[i], quantities[i].lower()): i for i in first}
    worn = {prefix_of(label) for label in labels}
    by_markers = [name for name in found if name in worn or any(label.startswith(f"{name}_") for label in labels)]
    left = [name for name in found if name not in by_markers and (name, _TURN) in starts and (name, _PLACE) in starts]
    notes = list[Diagnostic]()
    if by_markers:
        notes.append(diagnostic("parts_not_read", kind="poses", bodies=by_markers))
    if left and rotation_type and not rotation_type.lower().startswith("quat"):
        notes.append(diagnostic("parts_not_read", kind="euler", bodies=left))
        left = []
    if not left:
        return None, tuple(notes)
    notes.append(diagnostic("points_computed", kind="bodies", count=len(left), bodies=left))
    turns, places = (tuple(starts[name, quantity] for name in left) for quantity in (_TURN, _PLACE))
    return BodyColumns(tuple(left), turns, places), tuple(notes)


_AXES = re.compile(r'"?X"?\s*[,;\t]\s*"?Y"?\s*[,;\t]\s*"?Z"?')
"""In the row above the numbers: 'Frame', 'Time (Seconds)' and what these are in other languages come before."""
_TYPES = re.compile(r'^"*[,;\t]\s*"?Type"?\s*[,;\t]', re.IGNORECASE | re.MULTILINE)
"""The row of types, by which a file is recognised whose first line was cut away."""
_FIRST_LINE = "format version"
MEASURED = "marker"
"""Type of markers as measured; 'Rigid Body Marker' and 'Bone Marker' are where an asset's model expects them."""
_KNOWN_TYPES = (MEASURED, "rigid body", "bone", "skeleton")


def read_motive_csv(path: Path) -> MarkerSource:
    """Read the markers of a CSV file of Motive, and the poses of rigid bodies whose markers it does not hold.

    Bones, which Motive computes from markers, are left out.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is truncated, has no header.
        NoDetections: it holds no markers but rigid bodies, or none is ever seen.
    """
    lines = read_text(path).splitlines()
    at = next((i for i, line in enumerate(lines[:30]) if _AXES.search(line)), None)
    if not begins_as_motive("\n".join(lines[:30])):
        what = "The file is not a CSV of Motive: 'Format Version' is expected at its start."
        raise FileDamaged(what, where=str(path), hint="Export it again with its header.")
    if at is None:
        what = "The file is truncated: a row 'Frame, Time (Seconds), X, Y, Z, ...' is expected."
        raise FileDamaged(what, where=str(path), hint="Export it again.")
    # Spreadsheets of many countries save with semicolons and decimal commas.
    delimiter = delimiter_of(lines[at])
    whole = lines[0].lstrip('" ').lower().startswith(_FIRST_LINE)
    cells = header_cells(lines[0], delimiter) if whole else []
    meta = {name.lower(): value for name, value in zip(cells[::2], cells[1::2], strict=False)}
    header = [header_cells(line, delimiter) for line in lines[whole : at + 1] if line.strip(f'{delimiter} "')]
    columns, labels, notes = _markers(header, path)
    bodies, of_bodies = motive_bodies(header, labels, meta.get("rotation type", ""))
    rows = split_rows((line for line in lines[at + 1 :] if line.strip(f'{delimiter} "')), delimiter)
    for row in rows:
        if len(row) > 2 and ":" in row[2]:  # a time code
            row[2] = ""
    values = read_numbers(rows, at + 2, path, width=len(header[-1]))
    rate = next((v for k in ("export", "capture") if (v := number_in(meta.get(f"{k} frame rate"))) is not None), None)
    length = number_in(meta.get("total exported frames"))
    frames = frame_facts(values[:, :1].ravel(), values[:, 1:2].ravel(), rate, length, first=0)
    return MarkerSource(
        path=path,
        format=f"Motive CSV {meta.get('format version', '')}".strip(),
        positions=triples(values, columns),
        labels=labels,
        rate=frames.rate,
        default_unit="m",
        default_up_axis="y",
        unit=meta.get("length units", ""),
        first_frame=frames.first,
        bodies=None if bodies is None else bodies.poses(values),
        notes=(*notes, *of_bodies),
        problems=frames.problems,
    )


def begins_as_motive(head: str) -> bool:
    """Return whether a file begins as Motive's do, or with their row of types where the first line was cut away."""
    return head.lstrip('" ').lower().startswith(_FIRST_LINE) or bool(_TYPES.search(head))


def _markers(header: list[list[str]], path: Path) -> tuple[list[int], tuple[str, ...], tuple[Diagnostic, ...]]:
    """Return the first columns and the labels of the markers, and notes on what is left out.

    Args:
        header: the rows from the types to 'Frame', 'Time (Seconds)', ...
        path: the file, for messages.
    """
    at = next((i for i, row in enumerate(header) if any(_is_type(cell) for cell in row)), None)
    if at is None or at + 1 >= len(header) - 1:
        what = "The file has no row of types ('Marker', 'Rigid Body', ...) above its columns."
        raise FileDamaged(what, where=str(path), hint="Export it again with its header.")
    axes = header[-1]
    types, names, quantities = (_filled(row, len(axes)) for row in (header[at], header[at + 1], header[-2]))
    starts = [
        i
        for i in range(len(axes) - 2)
        if [axis.upper() for axis in axes[i : i + 3]] == ["X", "Y", "Z"] and quantities[i].lower() == "position"
    ]
    of_type = {kind: [i for i in starts if types[i].lower() == kind] for kind in dict.fromkeys(map(str.lower, types))}
    expected = [i for kind, columns in of_type.items() if kind != MEASURED and kind.endswith(MEASURED) for i in columns]
    chosen = of_type.get(MEASURED) or expected
    bodies = tuple(dict.fromkeys(names[i] for i in starts if types[i].lower() == "rigid body"))
    bones = sum(types[i].lower() == "bone" for i in starts)
    if not chosen:
        what = f"{len(bodies)} rigid bodies and {bones} bones" if bodies or bones else "none"
        hint = "Export it with 'Markers' switched on."
        raise NoDetections(f"The file holds no markers but {what}.", where=str(path), hint=hint)
    notes: list[Diagnostic] = []
    if bones:
        notes.append(diagnostic("parts_not_read", kind="bones", count=bones))
    if of_type.get(MEASURED) and expected:
        notes.append(diagnostic("parts_not_read", kind="expected", count=len(expected)))
    elif expected:
        notes.append(diagnostic("points_computed", kind="expected"))
    return chosen, tuple(names[i] for i in chosen), tuple(notes)


def _is_type(cell: str) -> bool:
    return cell.lower() in _KNOWN_TYPES or cell.lower().endswith(f" {MEASURED}")


def _filled(row: list[str], width: int) -> list[str]:
    return (row + [""] * width)[:width]
