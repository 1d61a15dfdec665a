"""COLMAP's text model, ``cameras.txt`` and ``images.txt``, as a calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid, FileDamaged
from solver_backend.exchange.lens import LENS_MODELS
from solver_backend.exchange.lens_model import MOST_TERMS
from solver_backend.geometry.quaternions import matrix_from_quat
from solver_backend.io.calibration.entry import CameraEntry, StatedCameras
from solver_backend.io.files import read_text

CAMERAS, IMAGES = "cameras.txt", "images.txt"
_MODELS = {
    name: (model.name, focals, places) for model in LENS_MODELS.values() for name, focals, places in model.colmap
}
"""Our lens model, number of focal lengths, and places among our terms of those that follow the centre."""


def is_colmap(folder: Path) -> bool:
    """Whether a folder holds COLMAP's text model."""
    return (folder / CAMERAS).is_file() and (folder / IMAGES).is_file()


def read_colmap(folder: Path) -> StatedCameras:
    """Return the cameras, one an image, in the model's unit; COLMAP's pixels begin at 0.5, ours at 0.

    Raises:
        FileMissing, FileDamaged: a file is not there, cut off, or no text model.
        CalibrationInvalid: a lens is of a model that is not read, or an image names a camera that is not there.

    Reference: COLMAP, "Output Format" (text) and "Camera Models".
    """
    lenses: dict[str, tuple[np.ndarray, np.ndarray, tuple[int, int], str]] = {}
    for number, *fields in _rows(folder / CAMERAS):
        lenses[number] = _lens(fields, f"{folder / CAMERAS}, camera {number}")
    entries = []
    for row in _rows(folder / IMAGES, every=2):
        place = str(folder / IMAGES)
        if len(row) < 10:
            raise FileDamaged(f"An image has {len(row)} fields; 10 are expected.", where=place)
        q, t = _numbers(row[1:5], place), _numbers(row[5:8], place)
        if row[8] not in lenses or not 0.5 < np.linalg.norm(q) < 2.0:
            raise CalibrationInvalid("The image has no camera or no rotation.", where=f"{place}, image {row[9]}")
        K, bent, size, model = lenses[row[8]]
        R = np.asarray(matrix_from_quat(q / np.linalg.norm(q)))
        entries.append(CameraEntry(Path(" ".join(row[9:])).stem, K, bent, R, t, size, model))
    return StatedCameras(entries)


def _lens(fields: list[str], place: str) -> tuple[np.ndarray, np.ndarray, tuple[int, int], str]:
    known = _MODELS.get(fields[0]) if fields else None
    if known is None:
        hint = f"Read are {', '.join(_MODELS)}."
        raise CalibrationInvalid(f"The lens model {fields[0] if fields else ''} is not read.", where=place, hint=hint)
    model, focals, which = known
    values = _numbers(fields[1:], place)
    if len(values) != 2 + focals + 2 + len(which):
        raise FileDamaged(f"{fields[0]} has {len(values) - 2} parameters; others are expected.", where=place)
    if not np.isfinite(values).all():
        raise FileDamaged("The lens has values that are not numbers.", where=place)
    size, values = (round(float(values[0])), round(float(values[1]))), values[2:]
    f, centre = values[[0, focals - 1]], values[focals : focals + 2] - 0.5
    bent = np.zeros(MOST_TERMS)
    bent[list(which)] = values[focals + 2 :]
    return np.array([[f[0], 0, centre[0]], [0, f[1], centre[1]], [0, 0, 1.0]]), bent, size, model


def _rows(path: Path, every: int = 1) -> list[list[str]]:
    """Return the fields of the lines that are no comments; of ``images.txt`` every other, points lie between."""
    lines = [line for line in read_text(path).splitlines() if not line.startswith("#")]
    return [line.split() for line in lines[::every] if line.strip()]


def _numbers(fields: list[str], place: str) -> np.ndarray:
    try:
        return np.array(fields, dtype=np.float64)
    except ValueError as error:
        what = f"A number is expected where the file holds something else ({error})."
        raise FileDamaged(what, where=place) from error
