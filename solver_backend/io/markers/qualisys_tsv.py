"""Markers in from TSV files of Qualisys Track Manager.

Source: the QTM user manual, "TSV file formats, motion data". Lines of a name and its values between tabs (NO_OF_FRAMES,
NO_OF_MARKERS, FREQUENCY, DATA_INCLUDED, EVENT, MARKER_NAMES, TRAJECTORY_TYPES), on demand a row of column names, then
the frames: on demand a frame number and a time, then x, y and z of every marker in millimetres. A marker that is not
seen is blank, 'null' or 0. QTM's world has Z up unless changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import BackendMissing, CaptureNotRecognised, FileDamaged, FileMissing
from solver_backend.exchange.so3 import matrix_from_rotvec
from solver_backend.io.files import read_text
from solver_backend.io.markers.source import MarkerSource, RigidBodies
from solver_backend.io.markers.text_table import between_tabs, frame_facts, number_in, read_numbers, triples

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
