"""Recognise and read a calibration, whichever of the formats it has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged, MocapError
from solver_backend.io.calibration.entry import Calibration, StatedCameras
from solver_backend.io.calibration.matrices import (
    SUFFIXES,
    MatrixFile,
    opencv_cameras,
    read_matrix_file,
    read_toml_cameras,
)
from solver_backend.io.calibration.programs import is_colmap, read_colmap, read_qualisys
from solver_backend.io.files import LARGEST_TEXT
from solver_backend.io.interpretation import interpret_cameras

FORMATS = (
    "Pose2Sim, anipose or caliscope .toml, Qualisys .qca.txt, OpenCV .yml, .yaml or .json, NeRF's transforms.json, "
    ".npz of K, R and t, projection matrices or DLT numbers as text, COLMAP's text model"
)
"""What is read, for messages."""

_OPENCV = (".yml", ".yaml", ".json", *SUFFIXES)


@dataclass(frozen=True)
class CalibrationFormat:
    """One format whose file or folder holds all cameras."""

    kind: str
    """Its name, for notes."""
    recognises: Callable[[Path], bool]
    """Whether a file or folder is of this format, by its name."""
    read: Callable[[Path], StatedCameras]
    """What it says; raises our own errors."""


_WHOLE = (
    CalibrationFormat("Qualisys", lambda path: path.name.lower().endswith((".qca.txt", ".qca")), read_qualisys),
    CalibrationFormat("TOML", lambda path: path.suffix.lower() == ".toml", read_toml_cameras),
    CalibrationFormat("COLMAP", is_colmap, read_colmap),
)
"""Formats that are read whole; those of YAML and JSON are rows of ``opencv_cameras.TREES``."""


def _whole_file(path: Path) -> CalibrationFormat | None:
    return next((row for row in _WHOLE if row.recognises(path)), None)


def read_calibration(path: Path | str, *, unit: str | None = None, up_axis: str | None = None) -> Calibration:
    """Read a calibration file, or a folder with one OpenCV file a camera or with COLMAP's text model.

    Args:
        path: file or folder.
        unit: length unit of the file ('m', 'cm', 'mm', 'inch', 'foot'); None infers it from the file.
        up_axis: axis of the file's world that points up ('z', 'y', '-y', ...); None is 'z'.

    Raises:
        CalibrationMissing: the path holds no calibration of a known format.
        CalibrationInvalid: a camera lacks a value or is impossible.
        FileMissing, FileDamaged: the file is not there, truncated or not what its name stands for.
    """
    path = Path(path)
    found = None
    if path.is_dir() and (known := _whole_file(path)) is not None:
        found = interpret_cameras(known.read(path), path, known.kind, unit, up_axis)
    if found is None and path.is_dir():
        files = sorted(p for p in path.iterdir() if p.suffix.lower() in _OPENCV and not p.name.startswith("."))
        found = _of_files([read_matrix_file(p) for p in files], path, unit, up_axis)
    elif found is None:
        found = _of_file(path, unit, up_axis)
    if found is None:
        hint = f"Formats that are read: {FORMATS}."
        raise CalibrationMissing("There is no camera calibration here.", where=str(path), hint=hint)
    return found


def calibrations_in(
    folder: Path, *, unit: str | None = None, up_axis: str | None = None
) -> tuple[list[Calibration], list[MocapError]]:
    """Return every calibration directly in a folder, and the errors of files that cannot be read or are bad ones.

    Each TOML and Qualisys file is one, so is each OpenCV file with several cameras; the other OpenCV files together
    are one. Files that are no calibrations are passed over.
    """
    files = sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    found: list[Calibration] = []
    errors: list[MocapError] = []
    named = sorted((p for p in files if _whole_file(p)), key=lambda path: path.suffix.lower() != ".toml")
    single: list[MatrixFile] = []
    groups: list[list[MatrixFile]] = []
    for path in (
        p for p in files if p not in named and p.suffix.lower() in _OPENCV and p.stat().st_size <= LARGEST_TEXT
    ):
        try:
            file = read_matrix_file(path)
        except FileDamaged as error:
            errors.append(error)
            continue
        if len(file.nodes) > 1:
            groups.append([file])
        else:
            single.append(file)
    readings = [partial(_of_file, path, unit, up_axis) for path in named]
    readings += [partial(_of_files, group, folder, unit, up_axis) for group in (*groups, single)]
    for read in readings:
        try:
            calibration = read()
        except (FileDamaged, CalibrationInvalid) as error:
            errors.append(error)
            continue
        if calibration is not None:
            found.append(calibration)
    return found, errors


def _of_file(path: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    """Return the calibration of one file, None if it is of no known format or holds no camera."""
    known = _whole_file(path)
    if known is not None:
        return interpret_cameras(known.read(path), path, known.kind, unit, up_axis)
    return _of_files([read_matrix_file(path)], path, unit, up_axis) if path.suffix.lower() in _OPENCV else None


def _of_files(files: Sequence[MatrixFile], folder: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    source = files[0].path if len(files) == 1 else folder
    return interpret_cameras(StatedCameras(opencv_cameras(files)), source, "OpenCV", unit, up_axis)
