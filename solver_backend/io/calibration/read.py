"""Recognise and read a calibration of any format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged, MocapError
from solver_backend.io.calibration.entry import Calibration, StatedCameras
from solver_backend.io.calibration.matrices import (
    SUFFIXES,
    MatrixFile,
    read_matrix_file,
    read_toml_cameras,
    stated_cameras,
)
from solver_backend.io.calibration.programs import is_colmap, read_colmap, read_qualisys
from solver_backend.io.files import LARGEST_TEXT
from solver_backend.io.interpretation import interpret_cameras

FORMATS = (
    "Pose2Sim, anipose or caliscope .toml, Qualisys .qca.txt, OpenCV .yml, .yaml or .json, NeRF's transforms.json, "
    ".npz of K, R and t, projection matrices or DLT numbers as text, COLMAP's text model"
)
"""Formats that are read, for messages."""
_OPENCV = (".yml", ".yaml", ".json", *SUFFIXES)
_WHOLE: tuple[tuple[str, Callable[[Path], bool], Callable[[Path], StatedCameras]], ...] = (
    ("Qualisys", lambda path: path.name.lower().endswith((".qca.txt", ".qca")), read_qualisys),
    ("TOML", lambda path: path.suffix.lower() == ".toml", read_toml_cameras),
    ("COLMAP", is_colmap, read_colmap),
)
"""Kind, recognition by name and reading of formats with all cameras in one file or folder."""


def read_calibration(path: Path | str, *, unit: str | None = None, up_axis: str | None = None) -> Calibration:
    """Read a calibration file, or a folder with one OpenCV file per camera or with COLMAP's text model.

    Args:
        path: file or folder.
        unit: length unit of the file ('m', 'cm', 'mm', 'inch', 'foot'). None infers it.
        up_axis: axis of the file's world that points up ('z', 'y', '-y', ...). None is 'z'.

    Raises:
        CalibrationMissing: the path holds no calibration of a known format.
        CalibrationInvalid: a camera lacks a value or is impossible.
        FileMissing, FileDamaged: the file is not there, truncated or not of the kind in its name.
    """
    path = Path(path)
    found = _of_file(path, unit, up_axis)
    if found is None and path.is_dir():
        files = sorted(p for p in path.iterdir() if p.suffix.lower() in _OPENCV and not p.name.startswith("."))
        found = _of_files([read_matrix_file(p) for p in files], path, unit, up_axis)
    if found is None:
        hint = f"Formats that are read: {FORMATS}."
        raise CalibrationMissing("There is no camera calibration here.", where=str(path), hint=hint)
    return found


def calibrations_in(
    folder: Path, *, unit: str | None = None, up_axis: str | None = None
) -> tuple[list[Calibration], list[MocapError]]:
    """Return every calibration directly in a folder, and the errors of damaged or invalid ones.

    Each TOML and Qualisys file is one, and each OpenCV file with several cameras. The other OpenCV files together are
    one. Other files are skipped.
    """
    files = sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    whole = [p for p in files if any(recognises(p) for _, recognises, _ in _WHOLE)]
    whole.sort(key=lambda path: path.suffix.lower() != ".toml")
    others = (p for p in files if p not in whole and p.suffix.lower() in _OPENCV and p.stat().st_size <= LARGEST_TEXT)
    errors: list[MocapError] = []
    single: list[MatrixFile] = []
    groups: list[list[MatrixFile]] = []
    for path in others:
        try:
            file = read_matrix_file(path)
        except FileDamaged as error:
            errors.append(error)
            continue
        if len(file.nodes) > 1:
            groups.append([file])
        else:
            single.append(file)
    readings = [partial(_of_file, path, unit, up_axis) for path in whole]
    readings += [partial(_of_files, group, folder, unit, up_axis) for group in (*groups, single)]
    found: list[Calibration | None] = []
    for read in readings:
        try:
            found.append(read())
        except (FileDamaged, CalibrationInvalid) as error:
            errors.append(error)
    return [calibration for calibration in found if calibration is not None], errors


def _of_file(path: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    """Return the calibration of one file or folder, None if it is of no known format or holds no camera."""
    for kind, recognises, read in _WHOLE:
        if recognises(path):
            return interpret_cameras(read(path), path, kind, unit, up_axis)
    if path.suffix.lower() not in _OPENCV or path.is_dir():
        return None
    return _of_files([read_matrix_file(path)], path, unit, up_axis)


def _of_files(files: Sequence[MatrixFile], folder: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    source = files[0].path if len(files) == 1 else folder
    return interpret_cameras(stated_cameras(files), source, "OpenCV", unit, up_axis)
