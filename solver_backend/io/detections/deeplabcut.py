"""DeepLabCut's CSV: heading rows scorer, (individuals,) bodyparts, coords, then one row a frame."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.regular_file import open_regular
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.files import read_text

_HEADINGS = ("scorer", "individuals", "bodyparts", "coords")
_COORDS = ("x", "y", "likelihood")
_START_BYTES = 64


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
    while rows and rows[0][0].strip().lower() in _HEADINGS:
        heading, *cells = rows.pop(0)
        headings[heading.strip().lower()] = [cell.strip() for cell in cells]
    if missing := [name for name in ("bodyparts", "coords") if name not in headings]:
        raise FileDamaged(
            f"The table lacks DeepLabCut's heading row '{missing[0]}'.", where=str(path), hint="Export the CSV again."
        )
    parts, coords = headings["bodyparts"], [name.lower() for name in headings["coords"]]
    people = headings.get("individuals", ["single"] * len(parts))
    if not len(parts) == len(coords) == len(people):
        raise FileDamaged("The heading rows differ in length.", where=str(path), hint="Export the CSV again.")
    try:
        numbers = [int(row[0]) for row in rows]
        values = np.array([[cell or "nan" for cell in row[1 : len(parts) + 1]] for row in rows], dtype=np.float64)
    except ValueError as error:
        raise FileDamaged(f"A row is short or holds what is no number ({error}).", where=str(path)) from error
    return frames_of_columns(numbers, values, people, parts, coords, path)


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
        coords: (N,) x, y, likelihood; others are left out.
        path: the file.

    Raises:
        FileDamaged: there are no frames.
    """
    names = tuple(dict.fromkeys(parts))
    found = np.full((len(values), len(dict.fromkeys(people)), len(names), 3), np.nan)
    who = {name: i for i, name in enumerate(dict.fromkeys(people))}
    for column, (person, part, coord) in enumerate(zip(people, parts, coords, strict=True)):
        if coord in _COORDS:
            found[:, who[person], names.index(part), _COORDS.index(coord)] = values[:, column]
    frames = {n: [person for person in found[row] if (person[:, 2] > 0).any()] for row, n in enumerate(numbers)}
    return CameraFrames.in_memory(frames, path, names)
