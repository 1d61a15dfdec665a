"""Recognise and read a calibration, whichever of the formats it has."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged, MocapError
from solver_backend.io.calibration.colmap import is_colmap, read_colmap
from solver_backend.io.calibration.entry import Calibration, CameraEntry, build_cameras, in_metres, meant_entries
from solver_backend.io.calibration.opencv_cameras import (
    SUFFIXES,
    MatrixFile,
    opencv_cameras,
    read_matrix_file,
    read_toml_cameras,
)
from solver_backend.io.calibration.qualisys import read_qualisys
from solver_backend.io.files import LARGEST_TEXT
from solver_backend.io.recognition.up_axis import with_up_axis

FORMATS = (
    "Pose2Sim, anipose or caliscope .toml, Qualisys .qca.txt, OpenCV .yml, .yaml or .json, NeRF's transforms.json, "
    ".npz of K, R and t, projection matrices or DLT numbers as text, COLMAP's text model"
)
"""What is read, for messages."""

_OPENCV = (".yml", ".yaml", ".json", *SUFFIXES)


def read_calibration(path: Path | str, *, unit: str | None = None, up_axis: str | None = None) -> Calibration:
    """Read a calibration file, or a folder with one OpenCV file a camera or with COLMAP's text model.

    Args:
        path: file or folder.
        unit: length unit of the file ('m', 'cm', 'mm', 'inch', 'foot'); None infers it from the file.
            Qualisys' is always mm.
        up_axis: axis of the file's world that points up ('z', 'y', '-y', ...); None is 'z'.

    Raises:
        CalibrationMissing: the path holds no calibration of a known format.
        CalibrationInvalid: a camera lacks a value or is impossible.
        FileMissing, FileDamaged: the file is not there, truncated or not what its name stands for.
    """
    path = Path(path)
    if path.is_dir() and is_colmap(path):
        found = _finished(read_colmap(path), path, "COLMAP", unit, up_axis)
        if found is not None:
            return found
    if path.is_dir():
        files = sorted(p for p in path.iterdir() if p.suffix.lower() in _OPENCV and not p.name.startswith("."))
        found = _of_files([read_matrix_file(p) for p in files], path, unit, up_axis)
    else:
        found = _of_file(path, unit, up_axis)
    if found is None:
        raise CalibrationMissing(
            "There is no camera calibration here.", where=str(path), hint=f"Formats that are read: {FORMATS}."
        )
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
    named = [p for p in files if p.suffix.lower() == ".toml"] + [p for p in files if is_qualisys(p)]
    single: list[MatrixFile] = []
    groups: list[list[MatrixFile]] = []
    for path in (p for p in files if p.suffix.lower() in _OPENCV and p.stat().st_size <= LARGEST_TEXT):
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


def is_qualisys(path: Path) -> bool:
    """Whether the name is that of a Qualisys calibration."""
    return path.name.lower().endswith((".qca.txt", ".qca"))


def _of_file(path: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    """Return the calibration of one file, None if it is of no known format or holds no camera."""
    if is_qualisys(path):
        entries, problems = read_qualisys(path)
        return _finished(entries, path, "Qualisys", unit, up_axis, problems)
    if path.suffix.lower() == ".toml":
        return _finished(read_toml_cameras(path), path, "TOML", unit, up_axis)
    return _of_files([read_matrix_file(path)], path, unit, up_axis) if path.suffix.lower() in _OPENCV else None


def _of_files(files: Sequence[MatrixFile], folder: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    """Return the calibration of files that may share cameras, called after the only one or their folder."""
    source = files[0].path if len(files) == 1 else folder
    return _finished(opencv_cameras(files), source, "OpenCV", unit, up_axis)


def _finished(
    entries: list[CameraEntry],
    path: Path,
    kind: str,
    unit: str | None,
    up_axis: str | None,
    problems: Sequence[Diagnostic] = (),
) -> Calibration | None:
    if not entries:
        return None
    names = [entry.name for entry in entries]
    if len(set(names)) < len(names):
        raise CalibrationInvalid("Two cameras have the same name.", where=f"{path}: {', '.join(names)}")
    entries, corrected = meant_entries(entries)
    if kind == "Qualisys":
        metric, unit_note, guessed = entries, diagnostic("unit_read", unit="mm", source="qualisys"), ""
    else:
        metric, unit_note, guessed = in_metres(entries, unit)
    try:
        cameras = build_cameras(metric, where=str(path))
    except CalibrationInvalid as error:
        where = error.where if str(path) in error.where else f"{path}, {error.where}"
        raise CalibrationInvalid(error.message, where=where, hint=error.hint) from error
    assumed = "qualisys" if kind == "Qualisys" else "default"
    axis_note = diagnostic("up_axis_read", source="given" if up_axis else assumed, axis=(up_axis or "z").upper())
    note = diagnostic("calibration_read", file=path.name, count=len(entries), kind=kind)
    return Calibration(
        cameras=with_up_axis(cameras, up_axis or "z"),
        source=path,
        guessed_unit=guessed,
        size_known=tuple(e.image_size is not None for e in metric),
        notes=(note, unit_note, axis_note),
        problems=(*problems, *corrected),
    )
