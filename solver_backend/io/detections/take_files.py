"""Kinds of files that hold one camera's whole take, but JSON: tables, HDF5, arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from solver_backend.io.detections import column_table, deeplabcut, point_arrays, point_rows, sleap
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.io.detections.deeplabcut_hdf5 import is_hdf5_table, read_hdf5_table


@dataclass(frozen=True)
class TakeFile:
    """One kind of such files."""

    recognises: Callable[[Path], bool]
    """Whether a file is of the kind, by its name or its first bytes."""
    camera: Callable[[Path], str]
    """The camera in a file's name."""
    read: Callable[[Path], CameraFrames]
    """Raises our own errors."""
    of_all: Callable[[Path], dict[str, Callable[[], CameraFrames]]] = lambda _: {}
    """The cameras of a file that holds all of them, and how each is read; none where it is one camera's."""


_KINDS = (
    TakeFile(deeplabcut.is_table, deeplabcut.camera_name, deeplabcut.read_table),
    TakeFile(column_table.is_table, sleap.camera_name, column_table.read_table, column_table.cameras_in),
    TakeFile(point_rows.is_table, sleap.camera_name, point_rows.read_table, point_rows.cameras_in),
    TakeFile(sleap.is_sleap, sleap.camera_name, sleap.read_sleap),
    TakeFile(is_hdf5_table, deeplabcut.camera_name, read_hdf5_table),
    TakeFile(point_arrays.is_array, lambda path: path.stem, point_arrays.read_array, point_arrays.cameras_in),
)
"""Asked in this order; a folder holds files of one kind."""


def take_files(folder: Path) -> tuple[TakeFile, list[Path]] | None:
    """Return the files of the first kind of which a folder holds any, None where it holds none."""
    listed = sorted(p for p in folder.iterdir() if p.is_file())  # of a table and its filtered one the latter stays
    for kind in _KINDS:
        if found := [path for path in listed if kind.recognises(path)]:
            return kind, found
    return None
