"""Tables with one row a point: its frame, its name, x, y and perhaps a score, a person and a camera."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.detections.column_table import FRAMES, by_camera, column_of, heading_of, read_rows

_NAMES = ("keypoint", "bodypart", "body_part", "joint", "landmark", "keypoint_name", "joint_name", "landmark_name",
          "part", "node", "point", "name", "keypoint_id", "keypoint_index", "joint_id", "joint_index", "landmark_id",
          "landmark_index")  # fmt: skip
_PEOPLE = ("person", "person_id", "track", "track_id", "individual", "instance", "subject", "id")
_X, _Y, _Z = ("x", "u", "x_px", "px"), ("y", "v", "y_px", "py"), ("z", "z_m", "z_mm")
_SCORES = ("score", "confidence", "conf", "likelihood", "visibility", "prob", "probability", "c", "p")
"""Headings in small letters, the likeliest first."""

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
    return by_camera(path, lambda heading, rows: _frames(heading, rows, path))


def read_table(path: Path) -> CameraFrames:
    """Return the frames of one camera; a point without a score is sure where it is there.

    Raises:
        FileDamaged: a row is short, or a value is no number.
    """
    return _frames(*read_rows(path), path)


def _frames(heading: list[str], rows: list[list[str]], path: Path) -> CameraFrames:
    frame, part, x, y = (column_of(heading, names) for names in (FRAMES[:-1], _NAMES, _X, _Y))
    score, person = column_of(heading, _SCORES), column_of(heading, _PEOPLE)
    assert frame is not None and part is not None and x is not None and y is not None
    columns = [column for column in (x, y, score) if column is not None]
    try:
        cells = list(map(itemgetter(frame, part, part if person is None else person, *columns), rows))
        numbers = np.array([row[0] for row in cells], np.float64).astype(np.int64)
        values = np.array([[cell.strip() or "nan" for cell in row[3:]] for row in cells], np.float64)
    except (ValueError, IndexError, OverflowError) as error:
        raise FileDamaged(
            f"A row is short or holds something that is not a number ({error}).", where=str(path)
        ) from error
    spelled = [row[1].strip() for row in cells]
    names = tuple(dict.fromkeys(spelled))
    at = {name: i for i, name in enumerate(names)}
    if all(name.isdecimal() for name in names):  # points by number are in the order of a joint set
        at, names = {name: int(name) - min(map(int, names)) for name in names}, ()
    if max(at.values(), default=0) > MOST_POINTS:
        raise FileDamaged(f"A point has the number {max(at.values())}.", where=str(path))
    there = np.isfinite(values[:, :2]).all(-1)
    sure = np.where(there, values[:, 2] if score is not None else 1.0, 0.0)
    who = {name: i for i, name in enumerate(dict.fromkeys(row[2] for row in cells))} if person is not None else {}
    people = np.array([who[row[2]] for row in cells]) if who else np.zeros(len(cells), np.int64)
    keys, group = np.unique(np.column_stack([numbers, people]), axis=0, return_inverse=True)
    points = np.zeros((len(keys), max(at.values(), default=-1) + 1, 3))
    seen = sure > 0
    rows_of, columns_of = group.reshape(-1)[seen], np.array([at[name] for name in spelled])[seen]
    points[rows_of, columns_of] = np.column_stack([values[seen, :2], sure[seen]])
    frames: dict[int, People] = {}
    for (number, _), one in zip(keys.tolist(), points, strict=True):
        people_here = frames.setdefault(number, [])
        if (one[:, 2] > 0).any():
            people_here.append(one)
    return CameraFrames.in_memory(frames, path, names)
