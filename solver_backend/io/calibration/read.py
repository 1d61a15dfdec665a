"""Recognise and read a calibration, whichever of the formats it has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from solver_backend.errors import CalibrationInvalid, CalibrationMissing
from solver_backend.io.calibration.entry import Calibration, CameraEntry, build_cameras
from solver_backend.io.calibration.opencv_cameras import read_opencv_cameras
from solver_backend.io.calibration.qualisys import read_qualisys
from solver_backend.io.calibration.toml_cameras import read_toml_cameras
from solver_backend.io.calibration.units import in_metres, with_up_axis

FORMATS = "Pose2Sim, anipose or caliscope .toml, Qualisys .qca.txt, OpenCV .yml, .yaml or .json"
"""What is read, for messages."""

_OPENCV = (".yml", ".yaml", ".json")


def read_calibration(path: Path | str, *, unit: str | None = None, up_axis: str | None = None) -> Calibration:
    """Read a calibration file, or a folder with one OpenCV file a camera.

    Args:
        path: file or folder.
        unit: length unit of the file ('m', 'cm', 'mm', 'inch', 'foot'); None tells it from the file.
            Qualisys' is always mm.
        up_axis: axis of the file's world that points up ('z', 'y', '-y', ...); None is 'z'.

    Raises:
        CalibrationMissing: the path holds no calibration of a known format.
        CalibrationInvalid: a camera lacks a value or is impossible.
        FileMissing, FileDamaged: the file is not there, truncated or not what its name says.
    """
    path = Path(path)
    found = _read(path, unit, up_axis)
    if found is None:
        raise CalibrationMissing(
            "There is no camera calibration here.", where=str(path), hint=f"Formats that are read: {FORMATS}."
        )
    return found


def calibrations_in(folder: Path, *, unit: str | None = None, up_axis: str | None = None) -> list[Calibration]:
    """Return every calibration directly in a folder: each TOML and Qualisys file, and its OpenCV files together.

    Raises:
        CalibrationInvalid, FileDamaged: a file is a calibration, and a bad one.
    """
    files = sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    sources: list[Path] = [p for p in files if p.suffix.lower() == ".toml"] + [p for p in files if is_qualisys(p)]
    found = [c for c in (_read(p, unit, up_axis) for p in sources) if c is not None]
    opencv = _read(folder, unit, up_axis)
    return found + ([opencv] if opencv is not None else [])


def is_qualisys(path: Path) -> bool:
    """Whether the name is that of a Qualisys calibration."""
    return path.name.lower().endswith((".qca.txt", ".qca"))


def _read(path: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    name = path.name.lower()
    if path.is_dir():
        files = sorted(p for p in path.iterdir() if p.suffix.lower() in _OPENCV and not p.name.startswith("."))
        return _finished(read_opencv_cameras(files), path, "OpenCV", unit, up_axis)
    if is_qualisys(path):
        entries, problems = read_qualisys(path)
        return _finished(entries, path, "Qualisys", unit, up_axis, problems)
    if name.endswith(".toml"):
        return _finished(read_toml_cameras(path), path, "TOML", unit, up_axis)
    if path.suffix.lower() in _OPENCV:
        return _finished(read_opencv_cameras([path]), path, "OpenCV", unit, up_axis)
    return None


def _finished(
    entries: list[CameraEntry],
    path: Path,
    kind: str,
    unit: str | None,
    up_axis: str | None,
    problems: Sequence[str] = (),
) -> Calibration | None:
    if not entries:
        return None
    names = [entry.name for entry in entries]
    if len(set(names)) < len(names):
        raise CalibrationInvalid("Two cameras have the same name.", where=f"{path}: {', '.join(names)}")
    if kind == "Qualisys":
        metric, unit_note = entries, "Lengths are read as mm, focal lengths as 1/64 pixel (Qualisys)."
    else:
        metric, unit_note = in_metres(entries, unit)
    try:
        cameras = build_cameras(metric, where=str(path))
    except CalibrationInvalid as error:
        where = error.where if str(path) in error.where else f"{path}, {error.where}"
        raise CalibrationInvalid(error.message, where=where, hint=error.hint) from error
    axis = (up_axis or "z").upper()
    reason = "as stated" if up_axis else ("as Qualisys has it" if kind == "Qualisys" else "the default")
    axis_note = f"The calibration's world is taken with {axis} up ({reason})."
    note = f"Calibration: {len(entries)} cameras from {path.name} ({kind})."
    return Calibration(
        cameras=with_up_axis(cameras, up_axis or "z"),
        source=path,
        size_known=tuple(e.image_size is not None for e in metric),
        notes=(note, unit_note, axis_note),
        problems=tuple(problems),
    )
