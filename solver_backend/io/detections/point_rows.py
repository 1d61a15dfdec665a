"""Tables with one row a point: its frame, its name, x, y and perhaps a score, a person and a camera."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.detections.column_table import FRAMES, by_camera, cells_of, column_of, heading_of, read_columns

_NAMES = ("keypoint", "bodypart", "body_part", "joint", "landmark", "keypoint_name", "joint_name", "landmark_name",
          "part", "node", "point", "name", "keypoint_id", "keypoint_index", "joint_id", "joint_index", "landmark_id",
          "landmark_index")  # fmt: skip
_PEOPLE = ("person", "person_id", "track", "track_id", "individual", "instance", "subject", "id")
_X, _Y, _Z = ("x", "u", "x_px", "px"), ("y", "v", "y_px", "py"), ("z", "z_m", "z_mm")
_SCORES = ("score", "confidence", "conf", "likelihood", "visibility", "prob", "probability", "c", "p")
"""Headings in small letters, the likeliest first."""

_LARGEST_NUMBER = 2.0**40
"""Of a frame: no recording has more, and people's numbers are added to multiples of it."""
MOST_POINTS = 1000
"""Greatest number of a point: bodies, hands and faces together have 553."""


def is_table(path: Path) -> bool:
    """Whether a file begins with such a heading row; positions in space, with z and no score, are none."""
    heading = heading_of(path)
    has = [column_of(heading, names) is not None for names in (_NAMES, _X, _Y, FRAMES[:-1])]
    in_space = column_of(heading, _Z) is not None and column_of(heading, _SCORES) is None
    return all(has) and not in_space


def cameras_in(path: Path) -> dict[str, Callable[[], CameraFrames]]:
    """Return the cameras of a table of all of them, and how each is read; none where it is one camera's."""
    return by_camera(path, lambda heading, rows: _frames(heading, partial(cells_of, rows), path))


def read_table(path: Path) -> CameraFrames:
    """Return the frames of one camera; a point without a score is sure where it is there.

    Raises:
        FileDamaged: a row is short, or a value is no number.
    """
    return _frames(*read_columns(path), path)


def _frames(heading: list[str], cells: Callable[[int], list[str]], path: Path) -> CameraFrames:
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
        raise FileDamaged(
            f"A row is short or holds something that is not a number ({error}).", where=str(path)
        ) from error
    at = _places(spelled)
    if max(at.values(), default=0) > MOST_POINTS:
        raise FileDamaged(
            f"A point has the number {max(at.values())}.", where=str(path),
            hint=f"Number the points of a person from 0; at most {MOST_POINTS} are read.",
        )  # fmt: skip
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
    """Return the column of each point's name as it is written; numbers are in the order of a joint set."""
    written = {name: name.strip() for name in dict.fromkeys(spelled)}
    if all(name.isdecimal() for name in written.values()):
        first = min(map(int, written.values()), default=0)
        return {name: int(number) - first for name, number in written.items()}
    columns = {name: i for i, name in enumerate(dict.fromkeys(written.values()))}
    return {name: columns[plain] for name, plain in written.items()}


def _floats(cells: list[str]) -> np.ndarray:
    """Return numbers, NaN where a cell is blank.

    Raises:
        ValueError: a cell is something else.
    """
    try:
        return np.fromiter(map(float, cells), np.float64)
    except ValueError:
        return np.fromiter((float(cell.strip() or "nan") for cell in cells), np.float64)
