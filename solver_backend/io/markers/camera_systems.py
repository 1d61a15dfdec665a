"""Read markers from Motive, Nexus and QTM text exports, and from MATLAB and TRC files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import (
    CaptureNotRecognised,
    FileDamaged,
    NoDetections,
    NonFiniteData,
)
from solver_backend.exchange.outputs import write_text
from solver_backend.exchange.so3 import matrix_from_quat, matrix_from_rotvec
from solver_backend.io.camera_names import listing
from solver_backend.io.files import read_text
from solver_backend.io.markers.c3d import unnamed_labels
from solver_backend.io.markers.mat_file import read_mat
from solver_backend.io.markers.source import MarkerSource, RigidBodies, left_out_note
from solver_backend.io.recognition.marker_labels import is_model_output, prefix_of
from solver_backend.io.text_table import (
    ROWS_LOOKED_AT,
    between_tabs,
    cells_of,
    delimiter_of,
    different_count,
    frame_facts,
    is_number,
    number_in,
    read_numbers,
    split_rows,
    triples,
)
from solver_backend.io.units_and_axes import metres_in, rotation_to_z_up
from solver_backend.types import MarkerCloud

# Motive, format versions 1.2 to 1.25 (OptiTrack documentation, "Data Export: CSV"). The first line alternates names and
# values. It is followed by rows of types, names, ids and quantities, then by the row "Frame", "Time (Seconds)", X, Y,
# Z. Rows differ between versions, so columns are identified by content. Cells of missing markers are blank. Y is up.
_AXES = re.compile(r'"?X"?\s*[,;\t]\s*"?Y"?\s*[,;\t]\s*"?Z"?')
"""Pattern of the row of axes above the numbers. Its first words depend on the language."""
_TYPES = re.compile(r'^"*[,;\t]\s*"?Type"?\s*[,;\t]', re.IGNORECASE | re.MULTILINE)
"""Pattern of the row of types, which identifies the format if the first line has been removed."""
_FORMAT_VERSION = "format version"
_MOTIVE_LINES = 30  # The row of axes must appear within this number of lines.
_BODY, _MARKER = "rigid body", "marker"
"""Column types. Motive predicts "Rigid Body Marker" and "Bone Marker" positions from a model of the body."""
_KNOWN_TYPES = (_MARKER, _BODY, "bone", "skeleton")
_TURN, _PLACE = "rotation", "position"


class _Columns(NamedTuple):
    """Type, name, quantity and axis of each Motive column. All except names are in lower case."""

    types: list[str]
    names: list[str]
    quantities: list[str]
    axes: list[str]

    @classmethod
    def of(cls, header: Sequence[Sequence[str]], path: Path) -> _Columns:
        """Parse the header of a Motive file, from the row of types to the row of axes."""
        lower = [[cell.lower() for cell in row] for row in header]
        kinds = ((i, cell) for i, row in enumerate(lower) for cell in row)
        at = next((i for i, cell in kinds if cell in _KNOWN_TYPES or cell.endswith(f" {_MARKER}")), None)
        if at is None or at + 1 >= len(header) - 1:
            what = "The file has no row of types ('Marker', 'Rigid Body', ...) above its columns."
            raise FileDamaged(what, where=str(path), hint="Export it again with its header.")
        width = len(header[-1])
        return cls(*([*row, *[""] * width][:width] for row in (lower[at], header[at + 1], lower[-2], lower[-1])))

    def starts(self, quantity: str) -> list[int]:
        """Return the first column of each x, y, z triple of a quantity."""
        every = range(len(self.axes) - 2)
        return [i for i in every if self.axes[i : i + 3] == ["x", "y", "z"] and self.quantities[i] == quantity]


def begins_as_motive(head: str) -> bool:
    """Return whether a file begins with a Motive header, or with its row of types."""
    return head.lstrip('" ').lower().startswith(_FORMAT_VERSION) or bool(_TYPES.search(head))


def read_motive_csv(path: Path) -> MarkerSource:
    """Read the markers in a Motive CSV, and the rigid bodies without markers."""
    lines = read_text(path).splitlines()
    at = next((i for i, line in enumerate(lines[:_MOTIVE_LINES]) if _AXES.search(line)), None)
    if not begins_as_motive("\n".join(lines[:_MOTIVE_LINES])):
        what = "The file is not a Motive CSV, because it does not start with 'Format Version'."
        raise FileDamaged(what, where=str(path), hint="Export it again with its header.")
    if at is None:
        what = "The file is truncated. It has no row 'Frame, Time (Seconds), X, Y, Z, ...'."
        raise FileDamaged(what, where=str(path), hint="Export the file again.")
    delimiter = delimiter_of(lines[at])
    whole = lines[0].lstrip('" ').lower().startswith(_FORMAT_VERSION)
    cells = cells_of(lines[0], delimiter) if whole else []
    meta = {name.lower(): value for name, value in zip(cells[::2], cells[1::2], strict=False)}
    blank = f'{delimiter} "'
    header = [cells_of(line, delimiter) for line in lines[whole : at + 1] if line.strip(blank)]
    columns = _Columns.of(header, path)
    chosen, notes = _motive_markers(columns, path)
    labels = tuple(columns.names[i] for i in chosen)
    bodies, of_bodies = _motive_bodies(columns, labels, meta.get("rotation type", ""))
    rows = split_rows((line for line in lines[at + 1 :] if line.strip(blank)), delimiter)
    for row in rows:
        if len(row) > 2 and ":" in row[2]:  # the cell is a time code
            row[2] = ""
    values = read_numbers(rows, at + 2, path, width=len(header[-1]))
    rate = next((v for k in ("export", "capture") if (v := number_in(meta.get(f"{k} frame rate"))) is not None), None)
    length = number_in(meta.get("total exported frames"))
    rate, problems = frame_facts(values[:, :1].ravel(), values[:, 1:2].ravel(), rate, length)
    return MarkerSource(
        path=path,
        format=f"Motive CSV {meta.get('format version', '')}".strip(),
        positions=triples(values, chosen),
        labels=labels,
        rate=rate,
        default_unit="m",
        default_up_axis="y",
        unit=meta.get("length units", ""),
        bodies=_motive_poses(bodies, values) if bodies else None,
        notes=(*notes, *of_bodies),
        problems=problems,
    )


def _motive_markers(columns: _Columns, path: Path) -> tuple[list[int], list[Diagnostic]]:
    """Return the first column of each marker. Also return notes about columns that are not read."""
    starts = columns.starts(_PLACE)
    measured = [i for i in starts if columns.types[i] == _MARKER]
    expected = [i for i in starts if columns.types[i] != _MARKER and columns.types[i].endswith(_MARKER)]
    expected.sort(key=lambda i: columns.types.index(columns.types[i]))
    bones = sum(columns.types[i] == "bone" for i in starts)
    if not (measured or expected):
        bodies = {columns.names[i] for i in starts if columns.types[i] == _BODY}
        what = f"{len(bodies)} rigid bodies and {bones} bones" if bodies or bones else "none"
        hint = "Export the take again with 'Markers' enabled."
        raise NoDetections(f"The file contains no markers, only {what}.", where=str(path), hint=hint)
    notes = [diagnostic("parts_not_read", kind="bones", count=bones)] if bones else []
    if measured and expected:
        notes.append(diagnostic("parts_not_read", kind="expected", count=len(expected)))
    elif expected:
        notes.append(diagnostic("points_computed", kind="expected"))
    return measured or expected, notes


def _motive_bodies(
    columns: _Columns, labels: Sequence[str], rotation_type: str
) -> tuple[dict[str, tuple[int, int]], list[Diagnostic]]:
    """Return the rotation and position columns of each rigid body without markers. Also return notes."""
    of_body = [i for i, kind in enumerate(columns.types) if kind == _BODY]
    starts: dict[tuple[str, str], int] = {}
    for i in of_body:
        if columns.axes[i : i + 3] == ["x", "y", "z"] and columns.quantities[i] in (_TURN, _PLACE):
            starts.setdefault((columns.names[i], columns.quantities[i]), i)
    worn = {prefix_of(label) for label in labels}
    found = list(dict.fromkeys(columns.names[i] for i in of_body))
    by_markers = [name for name in found if name in worn or any(label.startswith(f"{name}_") for label in labels)]
    left = [name for name in found if name not in by_markers and (name, _TURN) in starts and (name, _PLACE) in starts]
    notes = [diagnostic("parts_not_read", kind="poses", bodies=by_markers)] if by_markers else []
    is_quat = all(columns.axes[starts[name, _TURN] + 3 :][:1] == ["w"] for name in left)
    if left and not (is_quat and (not rotation_type or rotation_type.lower().startswith("quat"))):
        return {}, [*notes, diagnostic("parts_not_read", kind="euler", bodies=left)]
    if left:
        notes.append(diagnostic("points_computed", kind="bodies", count=len(left), bodies=left))
    return {name: (starts[name, _TURN], starts[name, _PLACE]) for name in left}, notes


def _motive_poses(bodies: Mapping[str, tuple[int, int]], values: np.ndarray) -> RigidBodies:
    """Return the poses of rigid bodies in F frames. A body is NaN in frames without a valid quaternion."""
    places = triples(values, [place for _, place in bodies.values()])
    quat = np.stack([values[:, [turn + 3, turn, turn + 1, turn + 2]] for turn, _ in bodies.values()], axis=1)
    length = np.linalg.norm(quat, axis=-1, keepdims=True)
    good = np.isfinite(length) & (length > 0.5)
    rotations = matrix_from_quat(np.where(good, quat, (1.0, 0.0, 0.0, 0.0)) / np.where(good, length, 1.0))
    return RigidBodies(tuple(bodies), np.where(good, places, np.nan), rotations)


# Nexus, and its predecessors Workstation and Polygon (Vicon Nexus documentation, "Export ASCII files"). A file consists
# of sections. Each has its name, its rate ("100" or "100,Hz"), a row with each label above the first of three columns,
# and a row "Frame, Sub Frame, X, Y, Z, ..." ("Field #, X, Y, Z" in older files). Nexus adds a row of units. The frames
# follow, up to an empty line. Cells of missing markers are blank. Z is up.
SECTIONS = ("trajectories", "joints", "segments", "model outputs", "devices", "events")
"""Names of the sections in a Nexus file. The first one contains markers."""
_SECTION_LINES = 6  # A section's row of axes must appear within this number of lines.


class _Trajectories(NamedTuple):
    """The markers in one section of a Nexus file."""

    numbers: np.ndarray  # (F,) frame numbers.
    positions: np.ndarray  # (F, M, 3) positions in the file's unit.
    labels: tuple[str, ...]
    unit: str
    outputs: int  # Number of points that are not positions.


def read_nexus_csv(path: Path) -> MarkerSource:
    """Read the markers in a Nexus CSV or text file."""
    lines = read_text(path).splitlines()
    sections = sections_of(lines)
    if not sections:
        what = f"The file is not a Nexus export, because no line is one of {listing(SECTIONS)}."
        raise FileDamaged(what, where=str(path), hint="Export the file again.")
    if SECTIONS[0] not in sections:
        hint = "Export the trial again with 'Trajectories' enabled."
        raise NoDetections(f"The file contains no markers, only {listing(sections)}.", where=str(path), hint=hint)
    starts = [i for i, line in enumerate(lines) if _section(line) == SECTIONS[0]]
    read = [_trajectories(lines, start, path) for start in starts]
    delimiter, blocks = read[-1][0], [block for _, block in read]
    # Nexus writes one block. Scripts that merge exports write one block per subject.
    same = [block for block in blocks if np.array_equal(block.numbers, blocks[0].numbers, equal_nan=True)]
    rate = number_in(next(iter(cells_of(lines[starts[0] + 1], delimiter)), None))
    rate, problems = frame_facts(blocks[0].numbers, rate=rate)
    if count := len(blocks) - len(same):
        problems += (diagnostic("parts_not_read", kind="blocks", severity=Severity.WARNING, count=count),)
    devices = _axes_row(lines, sections.get("devices", len(lines)))
    return MarkerSource(
        path=path,
        format="Nexus CSV",
        positions=np.concatenate([block.positions for block in same], axis=1),
        labels=tuple(label for block in same for label in block.labels),
        rate=rate,
        default_unit="mm",
        default_up_axis="z",
        unit=blocks[0].unit,
        analog_channels=() if devices is None else tuple(filter(None, cells_of(lines[devices], delimiter)[2:])),
        notes=left_out_note(sum(block.outputs for block in same)),
        problems=problems,
    )


def _trajectories(lines: Sequence[str], start: int, path: Path) -> tuple[str, _Trajectories]:
    at = _axes_row(lines, start)
    if at is None:
        what = "The file is truncated: a row 'Frame,Sub Frame,X,Y,Z' is expected below 'Trajectories'."
        raise FileDamaged(what, where=str(path), hint="Export the file again.")
    delimiter = delimiter_of(lines[at])
    axes, names = cells_of(lines[at], delimiter), cells_of(lines[at - 1], delimiter)
    names += [""] * (len(axes) - len(names))
    points = {i: names[i] for i in range(len(axes) - 2) if axes[i : i + 3] == ["X", "Y", "Z"]}
    markers = {i: label for i, label in points.items() if not is_model_output(label)}
    units = cells_of(lines[at + 1], delimiter) if at + 1 < len(lines) else []
    has_units = bool(units) and not units[0]
    first = at + 1 + has_units
    rows: list[list[str]] = []
    for line in lines[first:]:
        [cells] = split_rows([line], delimiter)
        if not cells[0].strip() or _section(line):
            break
        rows.append(cells)
    values = read_numbers(rows, first + 1, path, width=len(axes), leading=2)
    return delimiter, _Trajectories(
        numbers=values[:, 0] if len(values) else np.zeros(0),
        positions=triples(values, tuple(markers)),
        labels=tuple(markers.values()),
        unit=next(filter(None, units), "") if has_units else "",
        outputs=len(points) - len(markers),
    )


def sections_of(lines: Sequence[str]) -> dict[str, int]:
    """Find the sections of a Nexus file. Return the first line index of each, by lower-case name."""
    found: dict[str, int] = {}
    for i, line in enumerate(lines):
        if name := _section(line):
            found.setdefault(name, i)
    return found


def _section(line: str) -> str:
    name = line.strip(' ,;\t"').lower() if len(line) < 200 else ""
    return name if name in SECTIONS else ""


def _axes_row(lines: Sequence[str], start: int) -> int | None:
    below = range(start, min(start + _SECTION_LINES, len(lines)))
    return next((i for i in below if lines[i].strip(' "').lower().startswith(("frame", "field #"))), None)


# Qualisys (QTM user manual, "TSV file formats, motion data"). Each header line consists of a name and its values,
# separated by tabs. After an optional row of column names come the frames: optionally frame number and time, then x, y
# and z of every marker in mm. Cells of missing markers are blank, "null" or 0. Z is up unless the user changed it.
FIRST_LINE = "NO_OF_FRAMES"  # First word of a QTM TSV file.
_BODY_NUMBERS = 16  # Numbers per rigid body and frame in 6D data.
_SIX_D = "_6D"  # Suffix that QTM adds to the names of 6D files.
_AGREE = 1e-3  # Largest difference between the elements of equal rotations.
_KINDS = ("Labeled", "Unidentified")  # Trajectory groups that are read from MATLAB files.


def read_qualisys_tsv(path: Path) -> MarkerSource:
    """Read the markers in a QTM TSV file. Raise CaptureNotRecognised for a file with 2D or 6D data."""
    lines, first, header = _tsv(path)
    if not (lines and lines[0].strip().upper().startswith(FIRST_LINE)):
        raise FileDamaged(f"The file is not a QTM TSV, because it does not start with '{FIRST_LINE}'.", where=str(path))
    included = " ".join(header.get("DATA_INCLUDED", ["3D"]))
    if included.strip() and "3D" not in included.upper():
        beside = f" To read rigid bodies as props, keep this file next to the marker file, as take{_SIX_D}.tsv."
        hint = f"Export 3D data.{beside if '6D' in included.upper() else ''}"
        raise CaptureNotRecognised(f"The file has {included} data, but markers need 3D.", where=str(path), hint=hint)
    labels = [name for name in header.get("MARKER_NAMES", []) if name]
    timed = 2 if "FRAME" in header else 0
    values = _tsv_numbers(lines, first, path, width=timed + 3 * len(labels), leading=timed // 2)
    stated, rate, length = (_stated(header, name) for name in ("NO_OF_MARKERS", "FREQUENCY", FIRST_LINE))
    count = len(labels) or int(min(max(stated or 0, 0), values.shape[1] // 3))
    before = 2 if values.shape[1] > 1 and (timed or _has_frame_columns(values, count)) else 0
    numbers = values[:, 0] if before else np.arange(1.0, len(values) + 1)
    rate, problems = frame_facts(numbers, values[:, 1] if before else np.zeros(0), rate, length)
    return MarkerSource(
        path=path,
        format="Qualisys TSV",
        positions=triples(values, range(before, before + 3 * count, 3)),
        labels=(*labels, *[""] * (count - len(labels))),
        rate=rate,
        default_unit="mm",
        default_up_axis="z",
        bodies=_bodies_beside(path, len(values)),
        problems=(*different_count("names", stated, count), *problems),
    )


def _tsv(path: Path) -> tuple[list[str], int, dict[str, list[str]]]:
    """Split a TSV file. Return its lines, the index of the first line with numbers, and the header cells."""
    lines = read_text(path).splitlines()
    lines = between_tabs(lines, lines[0] if lines else "", least=1)
    rows = ([cell for cell in line.split("\t") if cell.strip()] for line in lines)
    first = next((i for i, cells in enumerate(rows) if cells and number_in(cells[0]) is not None), len(lines))
    header: dict[str, list[str]] = {}
    for line in lines[:first]:
        name, *cells = (cell.strip() for cell in line.split("\t"))
        header.setdefault(name.upper(), cells)
    return lines, first, header


def _tsv_numbers(lines: list[str], first: int, path: Path, width: int = 0, leading: int = 0) -> np.ndarray:
    rows = [line.split("\t") for line in lines[first:] if line.strip()]
    return read_numbers(rows, first + 1, path, width=width, leading=leading)


def _stated(header: Mapping[str, Sequence[str]], name: str) -> float | None:
    return number_in(" ".join(header.get(name, [])))


def _has_frame_columns(values: np.ndarray, markers: int) -> bool:
    if values.shape[1] < 2 or not len(values):
        return False
    if values.shape[1] == 3 * markers + 2:
        return True
    steps = np.diff(values[:, :2], axis=0)
    return bool(len(steps) and values.shape[1] != 3 * markers and (steps[:, 0] == 1).all() and (steps[:, 1] > 0).all())


def _bodies_beside(path: Path, frames: int) -> RigidBodies | None:
    """Read a marker file's rigid bodies from its 6D file, such as ``walk_6D.tsv``. Return None if none matches."""
    beside = path.with_name(f"{path.stem.removesuffix('_3D')}{_SIX_D}.tsv")
    if beside == path or not beside.is_file():
        return None
    lines, first, header = _tsv(beside)
    values = _tsv_numbers(lines, first, beside)
    names = [name for name in header.get("BODY_NAMES", []) if name]
    count = len(names) or int(_stated(header, "NO_OF_BODIES") or 0)
    before = values.shape[1] - _BODY_NUMBERS * count
    if not count or before not in (0, 2) or len(values) != frames:
        return None
    numbers = values[:, before:].reshape(frames, count, _BODY_NUMBERS)
    names += [f"Body {n + 1}" for n in range(len(names), count)]
    seen = np.isfinite(numbers[..., :3]).all(-1) & (numbers[..., 7:] != 0).any(-1)
    return RigidBodies(tuple(names), np.where(seen[..., None], numbers[..., :3], np.nan), _rotations(numbers, seen))


def _rotations(numbers: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the rotations (F, B, 3, 3) of B bodies. A file may list the nine elements by columns or by rows."""
    columns = np.nan_to_num(numbers[..., 7:]).reshape(*numbers.shape[:2], 3, 3)
    angles = np.moveaxis(np.radians(np.nan_to_num(numbers[..., 3:6])), -1, 0)
    x, y, z = (matrix_from_rotvec(angle[..., None] * axis) for angle, axis in zip(angles, np.eye(3), strict=True))
    by_rows = bool(seen.any()) and np.abs(columns - x @ y @ z)[seen].max() < _AGREE
    return columns if by_rows else np.swapaxes(columns, -1, -2)


def read_qualisys_mat(path: Path) -> MarkerSource:
    """Read the markers in a QTM MATLAB file.

    Raises:
        FileMissing, FileDamaged, CaptureNotRecognised: the file is missing, damaged or of another type.
    """
    records = [value for value in read_mat(path).values() if isinstance(value, dict)]
    record = next((value for value in records if isinstance(value.get("Trajectories"), dict)), None)
    if record is None:
        what = "The MATLAB file is not from Qualisys Track Manager, because it has no 'Trajectories'."
        raise CaptureNotRecognised(what, where=str(path), hint="Export C3D or TSV from the program that recorded it.")
    parts, labels = [], []
    for kind in _KINDS:
        group = record["Trajectories"].get(kind)
        data = group.get("Data") if isinstance(group, dict) else None
        if not isinstance(data, np.ndarray) or not data.size:
            continue
        data = data[..., None] if data.ndim == 2 else data  # MATLAB drops the axis if there is one frame
        if data.ndim != 3 or data.shape[1] < 3:
            raise FileDamaged(f"The file's trajectories have the shape {data.shape}.", where=str(path))
        names = group.get("Labels")
        names = [name if isinstance(name, str) else "" for name in (names if isinstance(names, list) else [names])]
        parts.append(data[:, :3].astype(np.float64))
        labels += [*names, *[""] * (len(data) - len(names))][: len(data)]
    if len({part.shape[-1] for part in parts}) > 1:
        raise FileDamaged("The file's trajectories have different lengths.", where=str(path))
    positions = np.concatenate(parts) if parts else np.zeros((0, 3, 0))
    rate, positions = _mat_number(record, "FrameRate"), np.moveaxis(positions, 2, 0)
    return MarkerSource(path, "Qualisys MAT", positions, tuple(labels), rate, "mm", "z")


def _mat_number(record: Mapping[str, Any], name: str) -> float | None:
    value = record.get(name)
    return float(value.ravel()[0]) if isinstance(value, np.ndarray) and value.size else None


# TRC (track row column), used by OpenSim, Cortex, Mokka, MotionBuilder and others (OpenSim user's guide, "Marker
# files"). Cells are separated by tabs. Rows: file type, names of the header values, the values, "Frame#", "Time" and
# labels, each above the first of three columns (some programs write more or fewer tabs), X1 Y1 Z1 ..., usually an empty
# line, and the frames. A missing marker is blank, NaN or 0. Header counts are often wrong, so rows are counted.
FILE_TYPE = "pathfiletype"  # First word of a TRC file in lower case.
_HEADER_LINES = 20  # The labels must appear within this number of lines.


def read_trc(path: Path) -> MarkerSource:
    """Read the markers in a TRC file. Raise FileMissing or FileDamaged."""
    lines = read_text(path).splitlines()
    heading = next((line for line in lines[:_HEADER_LINES] if line.strip(' "').lower().startswith("frame#")), "")
    lines = between_tabs(lines, heading)
    at = _line_of("frame#", lines[:_HEADER_LINES])
    if at is None:
        what = "The file is truncated or is not TRC: a line that begins with 'Frame#' is expected."
        raise FileDamaged(what, where=str(path), hint="Export the file again.")
    names, header = _line_of("datarate", lines[:at]), {}
    if names is not None and names + 1 < at:
        of, values = _cells(lines[names]), _cells(lines[names + 1])
        filled = [[cell for cell in cells if cell] for cells in (of, values)]  # doubled tabs leave empty cells
        of, values = filled if len(filled[0]) == len(filled[1]) else (of, values)
        header = {name.lower(): value for name, value in zip(of, values, strict=False)}
    labels = _labels(lines[at])
    first = next((i for i in range(at + 1, len(lines)) if is_number(_cells(lines[i])[0])), len(lines))
    rows = [line.split("\t") if "\t" in line else line.split() for line in lines[first:] if line.strip()]
    rows, stated = _without_doubled_tabs(rows, len(labels)), number_in(header.get("nummarkers"))
    # Other numbers may belong to unlabelled points, or to a header that was shifted by decimal commas.
    width = 2 + 3 * len(labels) if labels else 0
    values = read_numbers(rows, first + 1, path, width=width, sure=stated == len(labels))
    count = max(len(labels), -(-max(values.shape[1] - 2, 0) // 3))
    rate, length = number_in(header.get("datarate")), number_in(header.get("numframes"))
    rate, problems = frame_facts(values[:, :1].ravel(), values[:, 1:2].ravel(), rate, length)
    return MarkerSource(
        path=path,
        format="TRC",
        positions=triples(values, range(2, 2 + 3 * count, 3)),
        labels=(*labels, *[""] * (count - len(labels))),
        rate=rate,
        default_unit="mm",
        default_up_axis="y",
        unit=header.get("units", ""),
        problems=(*different_count("markers", stated, count), *problems),
    )


def _line_of(start: str, lines: list[str]) -> int | None:
    return next((i for i, line in enumerate(lines) if line.strip().lower().startswith(start)), None)


def _labels(line: str) -> list[str]:
    cells = _cells(line)[2:]
    named = [i for i, cell in enumerate(cells) if cell]
    if named and all(i % 3 == 0 for i in named):
        return cells[: named[-1] + 1 : 3]
    return [cells[i] for i in named]


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("\t")] if "\t" in line else line.split() or [""]


def _without_doubled_tabs(rows: list[list[str]], markers: int) -> list[list[str]]:
    sample = rows[:ROWS_LOOKED_AT]
    too_long = markers and any(len(row) > 3 + 3 * markers for row in sample)
    if too_long and not any(cell.strip() for row in sample for cell in row[1::2]):
        return [row[::2] for row in rows]
    return rows


def write_trc(path: Path | str, cloud: MarkerCloud, *, overwrite: bool = False, **form: str) -> Path:
    """Write markers to a TRC file. ``form`` contains the unit and the up axis (see ``trc_text``)."""
    return write_text(path, trc_text(Path(path).name, cloud, **form), overwrite=overwrite)


def trc_text(name: str, cloud: MarkerCloud, *, unit: str = "mm", up_axis: str = "y") -> str:
    """Format markers (metres, Z up) as a TRC file with the given unit and up axis.

    Raises:
        NonFiniteData: the frame rate is not positive.
        JobInvalid: the unit or axis is unknown.
    """
    if not (np.isfinite(cloud.fps) and cloud.fps > 0):
        raise NonFiniteData(f"The frame rate must be a positive number, not {cloud.fps}.", where=name)
    positions = np.asarray(cloud.positions, dtype=np.float64)
    frames, markers = positions.shape[:2]
    labels = cloud.labels or unnamed_labels(markers)
    values = (positions.reshape(-1, 3) @ rotation_to_z_up(up_axis) / metres_in(unit)).reshape(frames, 3 * markers)
    times = np.arange(frames) / cloud.fps
    rate = f"{cloud.fps:.10g}"  # 100 rather than 100.000000, but 119.88012 in full
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{markers}\t{unit}\t{rate}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(label.replace("\t", " ") for label in labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i}" for i in range(1, markers + 1) for axis in "XYZ"),
        "",
    ]
    rows = [
        f"{i}\t{time:.6f}\t" + "\t".join(f"{value:.6f}" if value == value else "NaN" for value in row)
        for i, (time, row) in enumerate(zip(times.tolist(), values.tolist(), strict=True), 1)
    ]
    return "\n".join(head + rows) + "\n"
