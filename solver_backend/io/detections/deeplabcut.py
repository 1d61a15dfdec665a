"""DeepLabCut's CSV, and JARVIS': heading rows scorer, (individuals,) bodyparts, coords, then one row a frame."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path, PurePath

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.regular_file import open_regular
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.files import read_text
from solver_backend.io.recognition.frame_numbers import frame_numbers

_HEADINGS = {"scorer": "scorer", "individuals": "individuals", "entities": "individuals", "bodyparts": "bodyparts",
             "coords": "coords"}  # fmt: skip
"""What each heading row is; JARVIS calls the individuals entities."""
_COORDS = {"x": 0, "y": 1, "likelihood": 2, "state": 2}
"""Column of each coordinate; JARVIS' state is 1 or 2 where a point was placed."""
_START_BYTES = 64
"""Bytes that recognise a file."""


def is_table(path: Path) -> bool:
    """Whether a file begins as DeepLabCut's tables do."""
    try:
        with open_regular(path) as file:
            return file.read(_START_BYTES).lstrip(b"\xef\xbb\xbf").lower().startswith(b"scorer,")
    except OSError:
        return False


def camera_name(path: Path) -> str:
    """Return the video's name from the file's: ``cam01DLC_resnet50_dance.csv`` is of ``cam01``."""
    return path.stem.split("DLC")[0].rstrip("_- ") or path.stem


def read_table(path: Path) -> CameraFrames:
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
        raise FileDamaged(
            f"The table lacks DeepLabCut's heading row '{missing[0]}'.", where=str(path), hint="Export the CSV again."
        )
    parts, coords = headings["bodyparts"], [name.lower() for name in headings["coords"]]
    people = headings.get("individuals", ["single"] * len(parts))
    if not len(parts) == len(coords) == len(people):
        raise FileDamaged("The heading rows differ in length.", where=str(path), hint="Export the CSV again.")
    try:
        values = np.array([[cell or "nan" for cell in row[1 : len(parts) + 1]] for row in rows], dtype=np.float64)
        numbers = _frame_numbers([row[0] for row in rows], path)
    except ValueError as error:
        raise FileDamaged(
            f"A row is short or holds something that is not a number ({error}).", where=str(path)
        ) from error
    if rows and values.shape[1] < len(parts):
        raise FileDamaged(f"The rows have {values.shape[1]} values, the headings {len(parts)}.", where=str(path))
    return frames_of_columns(numbers, values, people, parts, coords, path)


def _frame_numbers(cells: Sequence[str], path: Path) -> list[int]:
    """Return the numbers of rows, or of the pictures that they name."""
    if all(cell.strip().isdecimal() for cell in cells):
        return [int(cell) for cell in cells]
    return frame_numbers([PurePath(cell).stem for cell in cells], where=str(path)).tolist()


def frames_of_columns(
    numbers: Sequence[int], values: np.ndarray, people: Sequence[str], parts: Sequence[str], coords: Sequence[str],
    path: Path,
) -> CameraFrames:  # fmt: skip
    """Return frames of a table whose columns are each one coordinate of one point of one person.

    Args:
        numbers: of the F frames.
        values: (F, N).
        people: (N,) names.
        parts: (N,) names of the points.
        coords: (N,) x, y, likelihood; others are left out, and without likelihood a point is sure where it is there.
        path: the file.

    Raises:
        FileDamaged: there are no frames.
    """
    names = tuple(dict.fromkeys(parts))
    found = np.full((len(values), len(dict.fromkeys(people)), len(names), 3), np.nan)
    who = {name: i for i, name in enumerate(dict.fromkeys(people))}
    for column, (person, part, coord) in enumerate(zip(people, parts, coords, strict=True)):
        if coord in _COORDS:
            found[:, who[person], names.index(part), _COORDS[coord]] = values[:, column]
    if not {"likelihood", "state"} & set(coords):
        found[..., 2] = np.isfinite(found[..., :2]).all(-1)
    frames = {n: [person for person in found[row] if (person[:, 2] > 0).any()] for row, n in enumerate(numbers)}
    return CameraFrames.in_memory(frames, path, names)
