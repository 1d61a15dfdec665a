"""Cameras in arrays of numbers: NumPy's ``.npz``, and text files of projection matrices or DLT numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.npz import array_names, read_npz
from solver_backend.io.calibration.camera_fields import is_camera, is_field
from solver_backend.io.calibration.projection_matrix import DLT_NUMBERS, projection_of
from solver_backend.io.files import read_text

SUFFIXES = (".npz", ".txt", ".csv")
_LARGEST_TEXT, _LARGEST_ARRAYS = 1 << 16, 1 << 24
"""Bytes of a file that is looked at."""
_NAMES = ("names", "camera_names", "cameras")


def matrix_nodes(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    """Return name and values of each camera in a file, none where it is something else.

    Raises:
        FileDamaged: an ``.npz`` is truncated.
    """
    small = path.stat().st_size <= (_LARGEST_ARRAYS if path.suffix.lower() == ".npz" else _LARGEST_TEXT)
    if not small or path.suffix.lower() not in SUFFIXES:
        return []
    return _of_arrays(path) if path.suffix.lower() == ".npz" else _of_text(path)


def _of_arrays(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    if "format" in array_names(path):  # our own files, which have readers
        return []
    values = read_npz(path, lambda name: is_field(name) or name in _NAMES)
    if not is_camera(values):
        return []
    count = next((len(v) for v in values.values() if v.ndim == 3 and v.shape[1:] in ((3, 3), (3, 4))), 0)
    if not count:
        return [(path.stem, values)]
    names = next((values[n].astype(str).tolist() for n in _NAMES if n in values and values[n].shape == (count,)), None)
    names = names or [f"cam_{i + 1}" for i in range(count)]
    split = {key: value for key, value in values.items() if value.ndim and len(value) == count and key not in _NAMES}
    return [(name, {key: value[i] for key, value in split.items()}) for i, name in enumerate(names)]


def _of_text(path: Path) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the one camera of three rows of four numbers, or those of eleven rows, a column a camera."""
    rows = [line.replace(",", " ").split() for line in read_text(path).splitlines() if line.strip()]
    if len(rows) not in (3, DLT_NUMBERS) or len({len(row) for row in rows}) != 1:
        return []
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError:
        return []
    if table.shape == (3, 4):
        return [(path.stem, {"projection": table})]
    if len(table) != DLT_NUMBERS or table.shape[1] < 2:
        return []
    return [(f"cam_{i + 1}", {"projection": projection_of(column)}) for i, column in enumerate(table.T)]
