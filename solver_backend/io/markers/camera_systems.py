"""Markers in from CSV files of OptiTrack Motive (format versions 1.2 to 1.25).

Source: the OptiTrack documentation, "Data Export: CSV". The first line holds names and values in turn ('Format
Version', 'Capture Frame Rate', 'Rotation Type', 'Length Units', ...). Then come rows of types, names, ids (and parents,
in newer versions), of quantities ('Rotation', 'Position', 'Mean Marker Error'), and the row 'Frame', 'Time (Seconds)',
in some versions 'TimeCode', X, Y, Z, W. Which rows there are depends on the version, so columns are found by what is
in them. Cells of a marker that is not seen are blank. Motive's world has Y up.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import BackendMissing, CaptureNotRecognised, FileDamaged, FileMissing, NoDetections
from solver_backend.exchange.so3 import matrix_from_quat, matrix_from_rotvec
from solver_backend.io.camera_names import listing
from solver_backend.io.files import read_text
from solver_backend.io.markers.source import MarkerSource, RigidBodies, left_out_note
from solver_backend.io.markers.text_table import (
    between_tabs,
    delimiter_of,
    frame_facts,
    header_cells,
    number_in,
    read_numbers,
    split_rows,
    triples,
)
from solver_backend.io.recognition.marker_labels import is_model_output, prefix_of

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


WORDS = 16
"""Numbers of a body in a frame."""
ENDING = "_6D"
"""What QTM adds to the name of the file of 6D data."""
_AGREE = 1e-3
"""Elements of two rotations differ by so little where they are one."""


def bodies_file(path: Path) -> Path | None:
    """Return the file of 6D data that belongs to a file of markers, ``walk_6D.tsv`` of ``walk.tsv``; None without."""
    beside = path.with_name(f"{path.stem.removesuffix('_3D')}{ENDING}.tsv")
    return beside if beside != path and beside.is_file() else None


def qualisys_bodies(header: Mapping[str, Sequence[str]], values: np.ndarray, frames: int) -> RigidBodies | None:
    """Return the bodies of a table of 6D data; None where it is no such table, or of other frames.

    Args:
        header: cells by the name at the line's beginning, in capitals.
        values: (F, C) numbers, NaN where blank.
        frames: of the markers.
    """
    names = [name for name in header.get("BODY_NAMES", []) if name]
    count = len(names) or int(number_in(" ".join(header.get("NO_OF_BODIES", []))) or 0)
    before = values.shape[1] - WORDS * count
    if not count or before not in (0, 2) or len(values) != frames:
        return None
    words = values[:, before:].reshape(frames, count, WORDS)
    names = [*names, *(f"Body {n + 1}" for n in range(len(names), count))]
    seen = np.isfinite(words[..., :3]).all(-1) & (words[..., 7:] != 0).any(-1)
    return RigidBodies(tuple(names), np.where(seen[..., None], words[..., :3], np.nan), _rotations(words, seen))


def _rotations(words: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the (F, B, 3, 3) rotations: Rot[0] to Rot[8] by columns, or by rows where the angles agree with that."""
    columns = np.nan_to_num(words[..., 7:]).reshape(*words.shape[:2], 3, 3)
    angles = np.moveaxis(np.radians(np.nan_to_num(words[..., 3:6])), -1, 0)
    x, y, z = (matrix_from_rotvec(angle[..., None] * axis) for angle, axis in zip(angles, np.eye(3), strict=True))
    by_angles = x @ y @ z
    by_rows = bool(seen.any()) and np.abs(columns - by_angles)[seen].max() < _AGREE
    return columns if by_rows else np.swapaxes(columns, -1, -2)


FIRST_LINE = "NO_OF_FRAMES"
"""How the files begin."""


def read_qualisys_tsv(path: Path) -> MarkerSource:
    """Read the markers of a TSV file of QTM.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: it is truncated, is none of QTM.
        CaptureNotRecognised: it holds 2D or 6D data.
        NoDetections: it holds no markers, or none is ever seen.
    """
    lines = _lines(path)
    if not lines or not lines[0].strip().upper().startswith(FIRST_LINE):
        raise FileDamaged(f"The file is not one of QTM: '{FIRST_LINE}' is expected at its start.", where=str(path))
    first = next((i for i, line in enumerate(lines) if _starts_with_number(line)), len(lines))
    header = _header(lines[:first])
    included = " ".join(header.get("DATA_INCLUDED", ["3D"]))
    if included.strip() and "3D" not in included.upper():
        beside = f" Poses of rigid bodies become props: keep the file beside that of the markers, as take{ENDING}.tsv."
        hint = f"Export 3D data.{beside if '6D' in included.upper() else ''}"
        raise CaptureNotRecognised(f"The file holds {included} data; markers are 3D.", where=str(path), hint=hint)
    labels = [name for name in header.get("MARKER_NAMES", []) if name]
    timed = 2 if "FRAME" in header else 0
    values = _numbers(lines, first, path, width=timed + 3 * len(labels), leading=timed // 2)
    stated = number_in(" ".join(header.get("NO_OF_MARKERS", [])))
    count = len(labels) or int(min(max(stated or 0, 0), values.shape[1] // 3))
    before = 2 if "FRAME" in header or _has_frame_columns(values, count) else 0
    rate, length = (number_in(" ".join(header.get(name, []))) for name in ("FREQUENCY", FIRST_LINE))
    numbers = values[:, 0] if before else np.arange(1.0, len(values) + 1)
    frames = frame_facts(numbers, values[:, 1] if before else np.zeros(0), rate, length)
    problems: tuple[Diagnostic, ...] = ()
    if stated not in (None, count):
        problems = (diagnostic("count_not_as_stated", items="names", stated=f"{stated:g}", count=count),)
    return MarkerSource(
        path=path,
        format="Qualisys TSV",
        positions=triples(values, range(before, before + 3 * count, 3)),
        labels=(*labels, *[""] * (count - len(labels))),
        rate=frames.rate,
        default_unit="mm",
        default_up_axis="z",
        first_frame=frames.first,
        bodies=_bodies_beside(path, len(values)),
        problems=(*problems, *frames.problems),
    )


def _bodies_beside(path: Path, frames: int) -> RigidBodies | None:
    beside = bodies_file(path)
    if beside is None:
        return None
    lines = _lines(beside)
    first = next((i for i, line in enumerate(lines) if _starts_with_number(line)), len(lines))
    return qualisys_bodies(_header(lines[:first]), _numbers(lines, first, beside), frames)


def _lines(path: Path) -> list[str]:
    lines = read_text(path).splitlines()
    return between_tabs(lines, lines[0] if lines else "", least=1)


def _numbers(lines: list[str], first: int, path: Path, width: int = 0, leading: int = 0) -> np.ndarray:
    """Return the numbers of the frames, which begin at a line; see ``read_numbers``."""
    rows = [line.split("\t") for line in lines[first:] if line.strip()]
    return read_numbers(rows, first + 1, path, width=width, leading=leading)


def _starts_with_number(line: str) -> bool:
    cells = [cell for cell in line.split("\t") if cell.strip()]
    return bool(cells) and number_in(cells[0]) is not None


def _header(lines: list[str]) -> dict[str, list[str]]:
    header: dict[str, list[str]] = {}
    for line in lines:
        name, *cells = (cell.strip() for cell in line.split("\t"))
        header.setdefault(name.upper(), cells)
    return header


def _has_frame_columns(values: np.ndarray, markers: int) -> bool:
    if values.shape[1] < 2 or not len(values):
        return False
    if values.shape[1] == 3 * markers + 2:
        return True
    steps = np.diff(values[:, :2], axis=0)
    return bool(len(steps) and values.shape[1] != 3 * markers and (steps[:, 0] == 1).all() and (steps[:, 1] > 0).all())


KINDS = ("Labeled", "Unidentified")
"""Groups of trajectories that are read; those that somebody discarded are not."""


def read_qualisys_mat(path: Path) -> MarkerSource:
    """Read the trajectories of a MATLAB file of QTM.

    Raises:
        FileMissing: there is no such file.
        BackendMissing: SciPy is not installed.
        FileDamaged: it is truncated, or no MATLAB file of version 5 to 7.2.
        CaptureNotRecognised: it is none of QTM, or of MATLAB 7.3.
        NoDetections: it holds no markers, or none is ever seen.
    """
    record = _record(path)
    parts, labels = [], []
    for kind in KINDS:
        group = getattr(getattr(record, "Trajectories", None), kind, None)
        data = np.asarray(getattr(group, "Data", ()), dtype=np.float64)
        if data.size:
            data = data.reshape(-1, *data.shape[-2:])
            names = [str(name) for name in np.atleast_1d(getattr(group, "Labels", ()))]
            parts.append(data[:, :3])
            labels += [*names, *[""] * (len(data) - len(names))][: len(data)]
    rate, start = getattr(record, "FrameRate", None), getattr(record, "StartFrame", 1)
    frames = int(getattr(record, "Frames", 0))
    if len({part.shape[-1] for part in parts}) > 1 or any(part.shape[1] != 3 for part in parts):
        raise FileDamaged("The file's trajectories are of different lengths, or no points.", where=str(path))
    positions = np.concatenate(parts) if parts else np.zeros((0, 3, frames))
    rate, first = None if rate is None else float(rate), int(start) if np.isfinite(start) else 1
    positions = np.moveaxis(positions, 2, 0)
    return MarkerSource(path, "Qualisys MAT", positions, tuple(labels), rate, "mm", "z", first_frame=first)


def _record(path: Path) -> Any:
    try:
        matlab = import_module("scipy.io")
    except ImportError as error:
        hint = "Export C3D or TSV from QTM, or install SciPy in this Python."
        what = "MATLAB files are read with SciPy, which is not installed."
        raise BackendMissing(what, where=str(path), hint=hint) from error
    if not path.is_file():
        raise FileMissing("The file is not there.", where=str(path))
    try:
        content: dict[str, Any] = matlab.loadmat(path, squeeze_me=True, struct_as_record=False)
    except NotImplementedError as error:
        hint = "Save it in MATLAB with save(name, '-v7'), or export C3D or TSV from QTM."
        what = "The file is not supported: MATLAB 7.3 (HDF5)."
        raise CaptureNotRecognised(what, where=str(path), hint=hint) from error
    except Exception as error:  # SciPy raises what its parsers meet: of values, keys, types, memory, zlib
        what = "The file is truncated, or no MATLAB file of version 5 to 7.2."
        raise FileDamaged(what, where=str(path), hint="Export it again, or as C3D or TSV.") from error
    found = [value for name, value in content.items() if not name.startswith("__") and hasattr(value, "Trajectories")]
    if not found:
        what = "The MATLAB file is not one of Qualisys Track Manager: 'Trajectories' is expected."
        raise CaptureNotRecognised(what, where=str(path), hint="Export C3D or TSV from the program that recorded it.")
    return found[0]
