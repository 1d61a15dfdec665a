"""Tables with one row a point: its frame, its name, x, y and perhaps a score, a person and a camera."""

from __future__ import annotations

from collections.abc import Callable
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
    try:
        numbers = [int(float(row[frame])) for row in rows]
        names = tuple(dict.fromkeys(row[part].strip() for row in rows))
        who = [(n, "" if person is None else row[person]) for n, row in zip(numbers, rows, strict=True)]
        columns = [column for column in (x, y, score) if column is not None]
        values = np.array([[row[column].strip() or "nan" for column in columns] for row in rows], np.float64)
    except (ValueError, IndexError, OverflowError) as error:
        raise FileDamaged(f"A row is short or holds what is no number ({error}).", where=str(path)) from error
    if all(name.isdecimal() for name in names):  # points by number are in the order of a joint set
        column_by_name = {name: int(name) - min(map(int, names)) for name in names}
        names = ()
    else:
        column_by_name = {name: i for i, name in enumerate(names)}
    there = np.isfinite(values[:, :2]).all(-1)
    sure = np.where(there, values[:, 2] if score is not None else 1.0, 0.0)
    people = {key: np.zeros((max(column_by_name.values(), default=-1) + 1, 3)) for key in who}
    for key, row, point, certain in zip(who, rows, values, sure, strict=True):
        if certain > 0:
            people[key][column_by_name[row[part].strip()]] = *point[:2], certain
    frames: dict[int, People] = {number: [] for number in numbers}
    for (number, _), points in people.items():
        if (points[:, 2] > 0).any():
            frames[number].append(points)
    return CameraFrames.in_memory(frames, path, names)
