"""Ultralytics' text files: a file a picture, a line a person: class, box, and x, y, score of each point in shares."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.outputs import open_regular
from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.files import read_text
from solver_backend.io.recognition.frame_numbers import frame_numbers
from solver_backend.types import JointSet

_BOX = 5
"""Numbers before the points: class, and centre, width and height of the box."""
_LEAST_POINTS = 8
_NAME = re.compile(r"(?P<camera>.*?\w.*?)[_\-. ]+(?P<frame>\d{1,18})")
"""``cam01_12``: the video's name and the frame, from 1."""
_START_BYTES = 1 << 14
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
            numbers = np.array(file.read(_START_BYTES).decode("ascii").partition("\n")[0].split(), dtype=np.float64)
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
