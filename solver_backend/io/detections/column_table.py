"""Tables with a heading row whose columns are a point's x, y and score: SLEAP's CSV, and tables people make.

A column may name the camera of a row, where one table holds all of them.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path, PurePath

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import open_regular
from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.files import LONGEST_HEADING, read_text
from solver_backend.io.recognition.frame_numbers import frame_numbers
from solver_backend.types import JointSet

Cameras = dict[str, Callable[[], CameraFrames]]
"""How each camera of a table is read, by its name."""
_COORD = "(?P<coord>x|y|z|score|confidence|conf|likelihood|visibility|vis|prob|c|p|v)"
_COLUMN = re.compile(rf"(?P<name>.*\w)[ ._-]+{_COORD}", re.I)
"""``nose.x``, ``left_knee_y``, ``left knee confidence``."""
_COORD_FIRST = re.compile(rf"{_COORD}(?P<name>\d+|[ ._-]+\w.*)", re.I)
"""``x1``, ``v_32``, ``x_NOSE``, as scripts around MediaPipe write them."""
_NUMBERED = re.compile(r"(?:(?:pose[ _]?)?(?:landmarks?|keypoints?|points?|joints?|lm|kpt?|pt)[ ._-]?)?(\d{1,4})", re.I)
"""A point's number in the order of a joint set: ``12``, ``landmark_12``, ``kp12``."""
FRAMES = ("frame", "frame_idx", "frame_index", "frame_number", "frame_id", "frameid", "frame_no", "index", "")
"""Headings of the frame's number, in small letters; several rows of one frame are several people."""
CAMERAS = ("camera", "camera_id", "camera_name", "cam", "cam_id", "view", "view_id", "video")
"""Headings of the camera's name, in small letters."""
_COORDS = ("x", "y", "likelihood")
LEAST_POINTS = 8
"""Points with x and y that a table of a body has at least."""
_START_BYTES = 1 << 16
"""Bytes in which the first line of a file stands; chosen by hand."""


def is_table(path: Path) -> bool:
    """Whether a file begins with such a heading row; positions in space, with z and no score, are none."""
    whole = _whole_points(heading_of(path)).values()
    return len(whole) >= LEAST_POINTS and not any("z" in coords and "likelihood" not in coords for coords in whole)


def cameras_in(path: Path) -> Cameras:
    """Return the cameras of a table of all of them, and how each is read; none where it is one camera's."""
    return by_camera(path, lambda heading, rows: _frames(heading, rows, path))


def read_table(path: Path) -> CameraFrames:
    """Return the frames of one camera; a point without a score is sure where it is there.

    Raises:
        FileDamaged: a row is short, or a value is no number.
    """
    return _frames(*read_rows(path), path)


def by_camera(path: Path, read: Callable[[list[str], list[list[str]]], CameraFrames]) -> Cameras:
    """Return how each camera of a table is read that has a column of cameras; none where it has no such column.

    Args:
        path: of the table, whose rows are read once.
        read: returns the frames of rows under a heading.
    """
    if column_of(heading_of(path), CAMERAS) is None:
        return {}
    heading, rows = read_rows(path)
    column = column_of(heading, CAMERAS)
    assert column is not None
    cameras: dict[str, list[list[str]]] = {}
    for row in rows:
        cameras.setdefault(row[column].strip() if column < len(row) else "", []).append(row)
    return {name: partial(read, heading, rows) for name, rows in cameras.items() if name}


def heading_of(path: Path) -> list[str]:
    """Return the cells of a text file's first line, none where it is no text of a table."""
    if path.suffix.lower() not in (".csv", ".tsv", ".txt"):
        return []
    try:
        with open_regular(path) as file:
            first = file.read(_START_BYTES).decode("utf-8-sig", "replace").partition("\n")[0]
    except OSError:
        return []
    return _cells(first)


def read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the heading of a table and its rows.

    Raises:
        FileDamaged: it is no table.
    """
    return _rows(*_text_and_separator(path), path)


def read_columns(path: Path) -> tuple[list[str], Callable[[int], list[str]]]:
    """Return the heading of a table and what gives the cells of a column.

    Raises:
        FileDamaged: it is no table.
    """
    text, separator = _text_and_separator(path)
    if (cells := _even_cells(text, separator)) is not None:
        width = text.partition("\n")[0].count(separator) + 1
        return cells[:width], lambda column: cells[width + column :: width]
    heading, rows = _rows(text, separator, path)
    return heading, partial(cells_of, rows)


def cells_of(rows: list[list[str]], column: int) -> list[str]:
    """Return the cells of a column.

    Raises:
        IndexError: a row is short.
    """
    return [row[column] for row in rows]


def _text_and_separator(path: Path) -> tuple[str, str]:
    text = read_text(path).lstrip("\ufeff")
    separator = _separator(text)
    if separator != "," and "," in text:  # decimal commas, as spreadsheets of many languages write them
        text = text.replace(",", ".")
    return text, separator


def _even_cells(text: str, separator: str) -> list[str] | None:
    """Return all cells of a table without quotes or blank lines whose rows have one length, row after row, else None.

    One split of the whole text is four times as fast as a list for each row. The first cell of each row but the heading
    begins with a line break, by which unequal rows show.
    """
    text = text.replace("\r\n", "\n").rstrip("\n")
    if '"' in text or "\r" in text or "\n\n" in text:
        return None
    width, count = text.partition("\n")[0].count(separator) + 1, text.count("\n") + 1
    cells = text.replace("\n", f"{separator}\n").split(separator)
    if len(cells) != width * count or not all(cell.startswith("\n") for cell in cells[width::width]):
        return None
    return cells


def _rows(text: str, separator: str, path: Path) -> tuple[list[str], list[list[str]]]:
    try:
        heading, *rows = [row for row in csv.reader(io.StringIO(text), delimiter=separator) if row]
    except (csv.Error, ValueError) as error:
        raise FileDamaged(f"The table cannot be read ({error}).", where=str(path)) from error
    return heading, rows


def column_of(heading: list[str], names: Sequence[str]) -> int | None:
    """Return the column that has one of these headings, the likeliest first; None where none has."""
    plain = [name.strip().lower().replace(" ", "_") for name in heading]
    return next((plain.index(name) for name in names if name in plain), None)


def _frames(heading: list[str], rows: list[list[str]], path: Path) -> CameraFrames:
    points = _whole_points(heading)
    names, named = _in_order(list(points))
    frame = column_of(heading, FRAMES)
    try:
        numbers = [row if frame is None else int(float(cells[frame])) for row, cells in enumerate(rows)]
        values = _values(rows, [points[name].get(coord) for name in names for coord in _COORDS])
    except (ValueError, IndexError, OverflowError) as error:
        what = f"A row is short or holds something that is not a number ({error})."
        raise FileDamaged(what, where=str(path)) from error
    values = values.reshape(len(rows), len(names), len(_COORDS))
    values[..., 2] = np.where(np.isfinite(values[..., :2]).all(-1), values[..., 2], 0.0)
    frames: dict[int, People] = {number: [] for number in numbers}
    for number, person in zip(numbers, values, strict=True):
        if (person[:, 2] > 0).any():
            frames[number].append(person)
    return CameraFrames.in_memory(frames, path, tuple(names) if named else ())


def _in_order(names: list[str]) -> tuple[list[str], bool]:
    numbers = [int(found[1]) if (found := _NUMBERED.fullmatch(name)) else -1 for name in names]
    first = min(numbers, default=-1)
    if first in (0, 1) and sorted(numbers) == list(range(first, first + len(names))):
        return [name for _, name in sorted(zip(numbers, names, strict=True))], False
    return names, True


def _values(rows: list[list[str]], columns: list[int | None]) -> np.ndarray:
    """Return (rows, columns) numbers: NaN where a cell is blank, 1 where there is no column."""
    there = [column for column in columns if column is not None]
    values = np.ones((len(rows), len(columns)))
    if rows and there:
        chosen = itemgetter(*there, there[0])  # of a single column it would return no tuple
        cells = [chosen(row) for row in rows]
        try:
            read = np.array(cells, dtype=np.float64)
        except ValueError:
            read = np.array([[cell.strip() or "nan" for cell in row] for row in cells], dtype=np.float64)
        values[:, [column is not None for column in columns]] = read[:, :-1]
    return values


def _separator(text: str) -> str:
    return max(",;\t", key=text.partition("\n")[0].count)


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=_separator(line)), [])
    except csv.Error:
        return []


def _whole_points(heading: list[str]) -> dict[str, dict[str, int]]:
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


_NAMES = ("keypoint", "bodypart", "body_part", "joint", "landmark", "keypoint_name", "joint_name", "landmark_name")
_NAMES += ("part", "node", "point", "name", "keypoint_id", "keypoint_index", "joint_id", "joint_index", "landmark_id")
_NAMES += ("landmark_index",)
_PEOPLE = ("person", "person_id", "track", "track_id", "individual", "instance", "subject", "id")
_X, _Y, _Z = ("x", "u", "x_px", "px"), ("y", "v", "y_px", "py"), ("z", "z_m", "z_mm")
_SCORES = ("score", "confidence", "conf", "likelihood", "visibility", "prob", "probability", "c", "p")
"""Headings in small letters, the likeliest first."""

_LARGEST_NUMBER = 2.0**40
"""Of a frame: no recording has more, and people's numbers are added to multiples of it."""
MOST_POINTS = 1000
"""Greatest number of a point: bodies, hands and faces together have 553."""


def has_point_rows(path: Path) -> bool:
    """Whether a file begins with such a heading row; positions in space, with z and no score, are none."""
    heading = heading_of(path)
    has = [column_of(heading, names) is not None for names in (_NAMES, _X, _Y, FRAMES[:-1])]
    in_space = column_of(heading, _Z) is not None and column_of(heading, _SCORES) is None
    return all(has) and not in_space


def cameras_in_point_rows(path: Path) -> Cameras:
    """Return the cameras of a table of all of them, and how each is read; none where it is one camera's."""
    return by_camera(path, lambda heading, rows: _frames_of_points(heading, partial(cells_of, rows), path))


def read_point_rows(path: Path) -> CameraFrames:
    """Return the frames of one camera; a point without a score is sure where it is there.

    Raises:
        FileDamaged: a row is short, or a value is no number.
    """
    return _frames_of_points(*read_columns(path), path)


def _frames_of_points(heading: list[str], cells: Callable[[int], list[str]], path: Path) -> CameraFrames:
    frame, part, x, y = (column_of(heading, names) for names in (FRAMES[:-1], _NAMES, _X, _Y))
    score, person = column_of(heading, _SCORES), column_of(heading, _PEOPLE)
    assert frame is not None and part is not None and x is not None and y is not None
    try:
        spelled = cells(part)
        people = cells(person) if person is not None else []
        numbers = _floats(cells(frame))
        values = np.column_stack([_floats(cells(c)) for c in (x, y, score) if c is not None])
        if not (np.abs(numbers) < _LARGEST_NUMBER).all():
            raise ValueError("a frame's number")
    except (ValueError, IndexError, OverflowError) as error:
        what = f"A row is short or holds something that is not a number ({error})."
        raise FileDamaged(what, where=str(path)) from error
    at = _places(spelled)
    if max(at.values(), default=0) > MOST_POINTS:
        hint = f"Number the points of a person from 0; at most {MOST_POINTS} are read."
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
    frames: dict[int, People] = {}
    shown = (points[..., 2] > 0).any(-1).tolist()
    for number, one, is_shown in zip((keys // max(len(who), 1)).tolist(), points, shown, strict=True):
        people_here = frames.setdefault(number, [])
        if is_shown:
            people_here.append(one)
    named = tuple(dict.fromkeys(name.strip() for name in at))
    return CameraFrames.in_memory(frames, path, () if all(name.isdecimal() for name in named) else named)


def _places(spelled: Iterable[str]) -> dict[str, int]:
    written = {name: name.strip() for name in dict.fromkeys(spelled)}
    if all(name.isdecimal() for name in written.values()):
        first = min(map(int, written.values()), default=0)
        return {name: int(number) - first for name, number in written.items()}
    columns = {name: i for i, name in enumerate(dict.fromkeys(written.values()))}
    return {name: columns[plain] for name, plain in written.items()}


def _floats(cells: list[str]) -> np.ndarray:
    """Return numbers, NaN where a cell is blank."""
    try:
        return np.fromiter(map(float, cells), np.float64)
    except ValueError:
        return np.fromiter((float(cell.strip() or "nan") for cell in cells), np.float64)


_HEADINGS = {name: name for name in ("scorer", "individuals", "bodyparts", "coords")} | {"entities": "individuals"}
"""What each heading row is; JARVIS calls the individuals entities."""
_DLC_COORDS = {"x": 0, "y": 1, "likelihood": 2, "state": 2}
"""Column of each coordinate; JARVIS' state is 1 or 2 where a point was placed."""
_DLC_START_BYTES = 64
"""Bytes that recognise a file."""


def is_deeplabcut(path: Path) -> bool:
    """Whether a file begins as DeepLabCut's tables do."""
    try:
        with open_regular(path) as file:
            return file.read(_DLC_START_BYTES).lstrip(b"\xef\xbb\xbf").lower().startswith(b"scorer,")
    except OSError:
        return False


def deeplabcut_camera(path: Path) -> str:
    """Return the video's name from the file's: ``cam01DLC_resnet50_dance.csv`` is of ``cam01``."""
    return path.stem.split("DLC")[0].rstrip("_- ") or path.stem


def read_deeplabcut(path: Path) -> CameraFrames:
    """Return the frames of one camera.

    Raises:
        FileDamaged: a heading is missing, a row is short, or a value is no number.
    """
    try:
        rows = [row for row in csv.reader(io.StringIO(read_text(path))) if row]
    except csv.Error as error:
        raise FileDamaged(f"The table cannot be read ({error}).", where=str(path)) from error
    headings: dict[str, list[str]] = {}
    while rows and (heading := _HEADINGS.get(rows[0][0].strip().lower())):
        headings[heading] = [cell.strip() for cell in rows.pop(0)[1:]]
    if missing := [name for name in ("bodyparts", "coords") if name not in headings]:
        hint = "Export the CSV again."
        raise FileDamaged(f"The table lacks DeepLabCut's heading row '{missing[0]}'.", where=str(path), hint=hint)
    parts, coords = headings["bodyparts"], [name.lower() for name in headings["coords"]]
    people = headings.get("individuals", ["single"] * len(parts))
    if not len(parts) == len(coords) == len(people):
        raise FileDamaged("The heading rows differ in length.", where=str(path), hint="Export the CSV again.")
    try:
        values = np.array([[cell or "nan" for cell in row[1 : len(parts) + 1]] for row in rows], dtype=np.float64)
        numbers = _frame_numbers([row[0] for row in rows], path)
    except ValueError as error:
        what = f"A row is short or holds something that is not a number ({error})."
        raise FileDamaged(what, where=str(path)) from error
    if rows and values.shape[1] < len(parts):
        raise FileDamaged(f"The rows have {values.shape[1]} values, the headings {len(parts)}.", where=str(path))
    return frames_of_columns(numbers, values, people, parts, coords, path)


def _frame_numbers(cells: Sequence[str], path: Path) -> list[int]:
    if all(cell.strip().isdecimal() for cell in cells):
        return [int(cell) for cell in cells]
    return frame_numbers([PurePath(cell).stem for cell in cells], where=str(path)).tolist()


def frames_of_columns(
    numbers: Sequence[int],
    values: np.ndarray,
    people: Sequence[str],
    parts: Sequence[str],
    coords: Sequence[str],
    path: Path,
) -> CameraFrames:
    """Return frames of a table whose columns are each one coordinate of one point of one person.

    Args:
        numbers: of the F frames.
        values: (F, N).
        people: (N,) names.
        parts: (N,) names of the points.
        coords: (N,) x, y, likelihood; others are left out, and without likelihood a point is sure where it is there.

    Raises:
        FileDamaged: there are no frames.
    """
    names = tuple(dict.fromkeys(parts))
    found = np.full((len(values), len(dict.fromkeys(people)), len(names), 3), np.nan)
    who = {name: i for i, name in enumerate(dict.fromkeys(people))}
    for column, (person, part, coord) in enumerate(zip(people, parts, coords, strict=True)):
        if coord in _DLC_COORDS:
            found[:, who[person], names.index(part), _DLC_COORDS[coord]] = values[:, column]
    if not {"likelihood", "state"} & set(coords):
        found[..., 2] = np.isfinite(found[..., :2]).all(-1)
    frames = {n: [person for person in found[row] if (person[:, 2] > 0).any()] for row, n in enumerate(numbers)}
    return CameraFrames.in_memory(frames, path, names)


_BOX = 5
"""Numbers before the points: class, and centre, width and height of the box."""
_LEAST_POINTS = 8
_NAME = re.compile(r"(?P<camera>.*?\w.*?)[_\-. ]+(?P<frame>\d{1,18})")
"""``cam01_12``: the video's name and the frame, from 1."""
_FIRST_BYTES = 1 << 14
"""Bytes in which the first line of a file stands; chosen by hand."""


def files_of_cameras(folder: Path) -> dict[str, list[Path]]:
    """Return the text files of a folder by the video they name; {} where they are not of this kind."""
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".txt" and _NAME.fullmatch(p.stem))
    if not paths or not _is_people(paths[0]):
        return {}
    cameras: dict[str, list[Path]] = {}
    for path in paths:
        if found := _NAME.fullmatch(path.stem):
            cameras.setdefault(found["camera"], []).append(path)
    return cameras


def frames_of_files(paths: Sequence[Path], where: str) -> CameraFrames:
    """Return one camera's frames, by the number in each file's name; coordinates stay shares of the picture.

    Seventeen points are COCO's, which all of Ultralytics' own models find.

    Raises:
        FileDamaged: the names give no frame numbers.
    """
    by_number = dict(zip(frame_numbers([p.stem for p in paths], where=where).tolist(), paths, strict=True))
    numbers = sorted(by_number)
    files = [by_number[number] for number in numbers]
    people = _people(files[0]) if files else []
    names = JointSet.COCO_17.keypoints if people and len(people[0]) == JointSet.COCO_17.num_keypoints else ()
    return CameraFrames(
        np.array(numbers, np.int64), lambda row: _people(files[row]), lambda row: str(files[row]), keypoints=names
    )


def _people(path: Path) -> People:
    """Return (K, 3) of each line."""
    try:
        lines = [np.array(line.split(), dtype=np.float64) for line in read_text(path).splitlines() if line.strip()]
        return [_points(line) for line in lines]
    except ValueError as error:
        what = f"A line holds something that is not a number, or incomplete points ({error})."
        raise FileDamaged(what, where=str(path)) from error


def _points(line: np.ndarray) -> np.ndarray:
    """Return (K, 3) of a line's numbers, of which a last one beside whole points is a track's."""
    values = line[_BOX:]
    if len(values) % 3 == 1:
        values = values[:-1]
    return values.reshape(-1, 3)


def _is_people(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            numbers = np.array(file.read(_FIRST_BYTES).decode("ascii").partition("\n")[0].split(), dtype=np.float64)
    except (OSError, ValueError):
        return False
    points = (len(numbers) - _BOX) // 3
    box = numbers[1:_BOX]
    return bool(
        points >= _LEAST_POINTS
        and (len(numbers) - _BOX) % 3 in (0, 1)
        and numbers[0] == int(numbers[0])
        and (box >= 0).all()
        and (box <= 1).all()
    )
