"""Read detections from text tables. A row is a person or a point."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path, PurePath

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.files import LONGEST_HEADING, first_bytes, read_text
from solver_backend.io.recognition.frame_numbers import frame_numbers
from solver_backend.io.text_table import csv_rows, delimiter_of, heading_of
from solver_backend.types import JointSet

Cameras = dict[str, Callable[[], CameraFrames]]  # For each camera in a table, a function that reads it.
FRAMES = ("frame", "frame_idx", "frame_index", "frame_number", "frame_id", "frameid", "frame_no", "index", "")
"""Lower-case headings of the frame number column. Several rows with the same frame are several people."""
CAMERAS = ("camera", "camera_id", "camera_name", "cam", "cam_id", "view", "view_id", "video")
"""Lower-case headings of the camera column in a table with several cameras."""
LEAST_POINTS = 8  # Smallest number of points (with x and y columns) in a table of detections.


def _text(path: Path) -> tuple[str, str]:
    """Read a table's text and its delimiter. Decimal commas become points."""
    text = read_text(path)
    delimiter = delimiter_of(text.partition("\n")[0])
    return (text if delimiter == "," else text.replace(",", ".")), delimiter


def _rows(path: Path, text: tuple[str, str] | None = None) -> tuple[list[str], list[list[str]]]:
    """Split a table into its heading and its rows."""
    rows = csv_rows(*(text or _text(path)), path)
    if not rows:
        raise FileDamaged("The table has no heading row.", where=str(path))
    return rows[0], rows[1:]


def _by_camera(path: Path, read: Callable[[list[str], list[list[str]]], CameraFrames]) -> Cameras:
    """Return a reader for each camera in a table with a camera column, or {} for other tables."""
    column = _column(heading_of(path), CAMERAS)
    if column is None:
        return {}
    heading, rows = _rows(path)
    cameras: dict[str, list[list[str]]] = {}
    for row in rows:
        cameras.setdefault(row[column].strip() if column < len(row) else "", []).append(row)
    return {name: partial(read, heading, rows) for name, rows in cameras.items() if name}


def _column(heading: list[str], names: Sequence[str]) -> int | None:
    plain = [name.strip().lower().replace(" ", "_") for name in heading]
    return next((plain.index(name) for name in names if name in plain), None)


def _not_a_number(path: Path, error: Exception) -> FileDamaged:
    return FileDamaged(f"A row is too short, or contains a value that is not a number ({error}).", where=str(path))


# Tables with one row per person, and columns for the x, y and score of each point.
_COORD = "(?P<coord>x|y|z|score|confidence|conf|likelihood|visibility|vis|prob|c|p|v)"
_COLUMN = re.compile(rf"(?P<name>.*\w)[ ._-]+{_COORD}", re.I)
"""Headings such as ``nose.x``, ``left_knee_y`` and ``left knee confidence``."""
_COORD_FIRST = re.compile(rf"{_COORD}(?P<name>\d+|[ ._-]+\w.*)", re.I)
"""Headings such as ``x1``, ``v_32`` and ``x_NOSE``, which scripts around MediaPipe write."""
_NUMBERED = re.compile(r"(?:(?:pose[ _]?)?(?:landmarks?|keypoints?|points?|joints?|lm|kpt?|pt)[ ._-]?)?(\d{1,4})", re.I)
"""Number of a point in the order of a joint set: ``12``, ``landmark_12``, ``kp12``."""
_COORDS = ("x", "y", "likelihood")


def is_table(path: Path) -> bool:
    """Return whether a file begins with the heading of a table with one row per person."""
    whole = _points_in(heading_of(path)).values()
    return len(whole) >= LEAST_POINTS and not any("z" in coords and "likelihood" not in coords for coords in whole)


def cameras_in(path: Path) -> Cameras:
    """Return a reader for each camera in a table of several cameras, or {} for a single camera."""
    return _by_camera(path, lambda heading, rows: _frames(heading, rows, path))


def read_table(path: Path) -> CameraFrames:
    """Read a table with one row per person. A point without a score has confidence 1."""
    return _frames(*_rows(path), path)


def _frames(heading: list[str], rows: list[list[str]], path: Path) -> CameraFrames:
    points = _points_in(heading)
    names, named = _in_order(list(points))
    frame = _column(heading, FRAMES)
    try:
        numbers = [row if frame is None else int(float(cells[frame])) for row, cells in enumerate(rows)]
        values = _values(rows, [points[name].get(coord) for name in names for coord in _COORDS])
    except (ValueError, IndexError, OverflowError) as error:
        raise _not_a_number(path, error) from error
    values = values.reshape(len(rows), len(names), len(_COORDS))
    values[..., 2] = np.where(np.isfinite(values[..., :2]).all(-1), values[..., 2], 0.0)
    return CameraFrames.of_people(zip(numbers, values, strict=True), path, tuple(names) if named else ())


def _points_in(heading: list[str]) -> dict[str, dict[str, int]]:
    """Return the columns of each point that has both x and y."""
    for pattern in (_COLUMN, _COORD_FIRST):
        points: dict[str, dict[str, int]] = {}
        for column, name in enumerate(heading):
            if found := pattern.fullmatch(name.strip()) if len(name) <= LONGEST_HEADING else None:
                coord = found["coord"].lower()
                point = points.setdefault(found["name"].lstrip(" ._-"), {})
                point.setdefault(coord if coord in "xyz" else "likelihood", column)
        points = {name: coords for name, coords in points.items() if {"x", "y"} <= coords.keys()}
        if len(points) >= LEAST_POINTS:
            return points
    return {}


def _in_order(names: list[str]) -> tuple[list[str], bool]:
    """Sort numbered points, or keep the order of named points. Also return whether the points are named."""
    numbers = [int(found[1]) if (found := _NUMBERED.fullmatch(name)) else -1 for name in names]
    first = min(numbers, default=-1)
    if first in (0, 1) and sorted(numbers) == list(range(first, first + len(names))):
        return [name for _, name in sorted(zip(numbers, names, strict=True))], False
    return names, True


def _values(rows: list[list[str]], columns: list[int | None]) -> np.ndarray:
    """Convert the cells of the given columns to numbers. Empty cells are NaN. A missing column (None) contains ones."""
    there = [column for column in columns if column is not None]
    values = np.ones((len(rows), len(columns)))
    if rows and there:
        chosen = itemgetter(*there, there[0])  # with a single column it would not return a tuple
        cells = [chosen(row) for row in rows]
        try:
            read = np.array(cells, dtype=np.float64)
        except ValueError:
            read = np.array([[cell.strip() or "nan" for cell in row] for row in cells], dtype=np.float64)
        values[:, [column is not None for column in columns]] = read[:, :-1]
    return values


# Tables with one row per point.
_POINT_NAMES = """
    keypoint bodypart body_part joint landmark keypoint_name joint_name landmark_name part node point name
    keypoint_id keypoint_index joint_id joint_index landmark_id landmark_index
"""
_POINTS = tuple(_POINT_NAMES.split())
_PEOPLE = ("person", "person_id", "track", "track_id", "individual", "instance", "subject", "id")
_X, _Y, _Z = ("x", "u", "x_px", "px"), ("y", "v", "y_px", "py"), ("z", "z_m", "z_mm")
_SCORES = ("score", "confidence", "conf", "likelihood", "visibility", "prob", "probability", "c", "p")
"""Lower-case headings of the score column, most common first."""
_LARGEST_NUMBER = 2.0**40
"""Largest frame number, beyond any recording. A person's number is added to a multiple of the frame number."""
MOST_POINTS = 1000  # Largest point number. Body, hands and face together have 553 points.


def has_point_rows(path: Path) -> bool:
    """Return whether a file begins with the heading of a table with one row per point."""
    heading = heading_of(path)
    has = [_column(heading, names) is not None for names in (_POINTS, _X, _Y, FRAMES[:-1])]
    in_space = _column(heading, _Z) is not None and _column(heading, _SCORES) is None
    return all(has) and not in_space


def cameras_in_point_rows(path: Path) -> Cameras:
    """Return a reader for each camera in a table with one row per point, or {} for a single camera."""
    return _by_camera(path, lambda heading, rows: _frames_of_points(heading, partial(_cells, rows), path))


def read_point_rows(path: Path) -> CameraFrames:
    """Read a table with one row per point. A point without a score has confidence 1."""
    text, delimiter = _text(path)
    if (cells := _even_cells(text, delimiter)) is not None:
        width = text.partition("\n")[0].count(delimiter) + 1
        return _frames_of_points(cells[:width], lambda column: cells[width + column :: width], path)
    heading, rows = _rows(path, (text, delimiter))
    return _frames_of_points(heading, partial(_cells, rows), path)


def _cells(rows: list[list[str]], column: int) -> list[str]:
    return [row[column] for row in rows]


def _even_cells(text: str, delimiter: str) -> list[str] | None:
    """Split a table without quotes or blank lines into cells, or return None if row lengths differ.

    Splitting the whole text once is four times as fast as splitting each row. The first cell of each row after the
    heading begins with a line break, which reveals rows of a different length.
    """
    text = text.replace("\r\n", "\n").rstrip("\n")
    if '"' in text or "\r" in text or "\n\n" in text:
        return None
    width, count = text.partition("\n")[0].count(delimiter) + 1, text.count("\n") + 1
    cells = text.replace("\n", f"{delimiter}\n").split(delimiter)
    if len(cells) != width * count or not all(cell.startswith("\n") for cell in cells[width::width]):
        return None
    return cells


def _frames_of_points(heading: list[str], cells: Callable[[int], list[str]], path: Path) -> CameraFrames:
    frame, part, x, y = (_column(heading, names) for names in (FRAMES[:-1], _POINTS, _X, _Y))
    score, person = _column(heading, _SCORES), _column(heading, _PEOPLE)
    assert frame is not None and part is not None and x is not None and y is not None
    try:
        spelled = cells(part)
        people = cells(person) if person is not None else []
        numbers = _floats(cells(frame))
        values = np.column_stack([_floats(cells(c)) for c in (x, y, score) if c is not None])
        if not (np.abs(numbers) < _LARGEST_NUMBER).all():
            raise ValueError("a frame's number")
    except (ValueError, IndexError, OverflowError) as error:
        raise _not_a_number(path, error) from error
    at = _places(spelled)
    if max(at.values(), default=0) > MOST_POINTS:
        hint = f"Number a person's points from 0 to {MOST_POINTS} at most."
        raise FileDamaged(f"A point has the number {max(at.values())}.", where=str(path), hint=hint)
    there = np.isfinite(values[:, :2]).all(-1)
    sure = np.where(there, values[:, 2] if score is not None else 1.0, 0.0)
    who = {name: i for i, name in enumerate(dict.fromkeys(people))}
    keys = numbers.astype(np.int64) * max(len(who), 1)
    keys += np.fromiter(map(who.__getitem__, people), np.int64) if who else 0
    keys, group = np.unique(keys, return_inverse=True)
    points = np.zeros((len(keys), max(at.values(), default=-1) + 1, 3))
    seen = sure > 0
    column = np.fromiter(map(at.__getitem__, spelled), np.int64)
    points[group[seen], column[seen]] = np.column_stack([values[seen, :2], sure[seen]])
    named = tuple(dict.fromkeys(name.strip() for name in at))
    names = () if all(name.isdecimal() for name in named) else named
    return CameraFrames.of_people(zip((keys // max(len(who), 1)).tolist(), points, strict=True), path, names)


def _places(spelled: Iterable[str]) -> dict[str, int]:
    """Return the index of each point, from its number or from the order of the names."""
    written = {name: name.strip() for name in dict.fromkeys(spelled)}
    if all(name.isdecimal() for name in written.values()):
        first = min(map(int, written.values()), default=0)
        return {name: int(number) - first for name, number in written.items()}
    columns = {name: i for i, name in enumerate(dict.fromkeys(written.values()))}
    return {name: columns[plain] for name, plain in written.items()}


def _floats(cells: list[str]) -> np.ndarray:
    try:
        return np.fromiter(map(float, cells), np.float64)
    except ValueError:
        return np.fromiter((float(cell.strip() or "nan") for cell in cells), np.float64)


# DeepLabCut and JARVIS. JARVIS calls individuals entities.
_HEADINGS = {name: name for name in ("scorer", "individuals", "bodyparts", "coords")} | {"entities": "individuals"}
"""Our name for the first cell of each heading row."""
_DLC_COORDS = {"x": 0, "y": 1, "likelihood": 2, "state": 2}
"""Index of each coordinate. JARVIS writes state 1 or 2 for an annotated point."""
_DLC_START_BYTES = 64  # Number of bytes read to recognise a file.


def is_deeplabcut(path: Path) -> bool:
    """Return whether a file begins like a DeepLabCut or JARVIS table."""
    return first_bytes(path, _DLC_START_BYTES).lstrip(b"\xef\xbb\xbf").lower().startswith(b"scorer,")


def deeplabcut_camera(path: Path) -> str:
    """Extract the video name, such as ``cam01``, from the name of a DeepLabCut file."""
    return path.stem.split("DLC")[0].rstrip("_- ") or path.stem


def read_deeplabcut(path: Path) -> CameraFrames:
    """Read a DeepLabCut or JARVIS table."""
    rows = csv_rows(read_text(path), ",", path)
    headings: dict[str, list[str]] = {}
    while rows and (heading := _HEADINGS.get(rows[0][0].strip().lower())):
        headings[heading] = [cell.strip() for cell in rows.pop(0)[1:]]
    if missing := [name for name in ("bodyparts", "coords") if name not in headings]:
        hint = "Export the CSV again."
        raise FileDamaged(f"The table has no DeepLabCut heading row '{missing[0]}'.", where=str(path), hint=hint)
    parts, coords = headings["bodyparts"], [name.lower() for name in headings["coords"]]
    people = headings.get("individuals", ["single"] * len(parts))
    if not len(parts) == len(coords) == len(people):
        raise FileDamaged("The heading rows differ in length.", where=str(path), hint="Export the CSV again.")
    if not rows:
        return CameraFrames.in_memory({}, path)
    try:
        values = np.array([[cell or "nan" for cell in row[1 : len(parts) + 1]] for row in rows], dtype=np.float64)
        written = [row[0] for row in rows]
        numbers = [int(cell) for cell in written] if all(cell.strip().isdecimal() for cell in written) else None
    except ValueError as error:
        raise _not_a_number(path, error) from error
    if numbers is None:
        numbers = frame_numbers([PurePath(cell).stem for cell in written], where=str(path)).tolist()
    if values.shape[1] < len(parts):
        raise FileDamaged(
            f"The rows have {values.shape[1]} values, but there are {len(parts)} headings.", where=str(path)
        )
    return frames_of_columns(numbers, values, people, parts, coords, path)


def frames_of_columns(
    numbers: Sequence[int],
    values: np.ndarray,
    people: Sequence[str],
    parts: Sequence[str],
    coords: Sequence[str],
    path: Path,
) -> CameraFrames:
    """Build camera frames from a table with one column per person, point and coordinate.

    Args:
        numbers: numbers of the F frames.
        values: (F, N) cells of the table.
        people: (N,) person of each column.
        parts: (N,) point of each column.
        coords: (N,) x, y or likelihood. Other columns are ignored. Without likelihood, the confidence is 1.
        path: file, for errors.
    """
    names = tuple(dict.fromkeys(parts))
    who = {name: i for i, name in enumerate(dict.fromkeys(people))}
    found = np.full((len(values), len(who), len(names), 3), np.nan)
    for column, (person, part, coord) in enumerate(zip(people, parts, coords, strict=True)):
        if coord in _DLC_COORDS:
            found[:, who[person], names.index(part), _DLC_COORDS[coord]] = values[:, column]
    if not {"likelihood", "state"} & set(coords):
        found[..., 2] = np.isfinite(found[..., :2]).all(-1)
    return CameraFrames.of_array(found, path, names, numbers)


# Ultralytics: a file per image, with a line per person: class, box, and x, y (fractions of the image), score per point.
_BOX = 5  # Numbers before the points: class, and centre, width and height of the box.
_NAME = re.compile(r"(?P<camera>.*?\w.*?)[_\-. ]+(?P<frame>\d{1,18})")
"""``cam01_12``: video name and frame number (from 1)."""
_LINE_BYTES = 1 << 14  # Largest length of a file's first line in bytes, chosen by hand.


def files_of_cameras(folder: Path) -> dict[str, list[Path]]:
    """Group Ultralytics text files by the video in their names, or return {} for other files."""
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".txt" and _NAME.fullmatch(p.stem))
    cameras: dict[str, list[Path]] = {}
    if paths and _is_line_of_person(paths[0]):
        for path in paths:
            if found := _NAME.fullmatch(path.stem):
                cameras.setdefault(found["camera"], []).append(path)
    return cameras


def frames_of_files(paths: Sequence[Path], where: str) -> CameraFrames:
    """Read one camera's Ultralytics text files. Their names contain the frame numbers.

    A person with 17 points has the COCO joint set, because all Ultralytics models detect this set.
    """
    by_number = dict(zip(frame_numbers([p.stem for p in paths], where=where).tolist(), paths, strict=True))
    numbers = sorted(by_number)
    files = [by_number[number] for number in numbers]
    people = _lines(files[0]) if files else []
    names = JointSet.COCO_17.keypoints if people and len(people[0]) == JointSet.COCO_17.num_keypoints else ()
    return CameraFrames(
        np.array(numbers, np.int64), lambda row: _lines(files[row]), lambda row: str(files[row]), keypoints=names
    )


def _lines(path: Path) -> People:
    """Read a person's points (K, 3) from each line. An extra number after the last point is a track number."""
    try:
        lines = [np.array(line.split(), dtype=np.float64) for line in read_text(path).splitlines() if line.strip()]
        points = [line[_BOX:] for line in lines]
        return [(p[:-1] if len(p) % 3 == 1 else p).reshape(-1, 3) for p in points]
    except ValueError as error:
        what = f"A line contains a value that is not a number, or incomplete points ({error})."
        raise FileDamaged(what, where=str(path)) from error


def _is_line_of_person(path: Path) -> bool:
    try:
        line = first_bytes(path, _LINE_BYTES).decode("ascii").partition("\n")[0]
        numbers = np.array(line.split(), dtype=np.float64)
    except ValueError:
        return False
    points, rest = divmod(len(numbers) - _BOX, 3)
    if points < LEAST_POINTS or rest == 2:
        return False
    box = numbers[1:_BOX]
    return bool(numbers[0].is_integer() and (box >= 0).all() and (box <= 1).all())
