"""Recognise and read a camera calibration in any supported format."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from solver_backend.exchange.errors import CalibrationInvalid, CalibrationMissing, FileDamaged, MocapError
from solver_backend.io.calibration.entry import Calibration, StatedCameras
from solver_backend.io.calibration.matrices import READ, MatrixFile, read_matrix_file, read_toml_cameras, stated_cameras
from solver_backend.io.calibration.programs import (
    is_colmap,
    is_metashape,
    read_colmap,
    read_metashape,
    read_qualisys,
    read_vicon,
)
from solver_backend.io.files import LARGEST_TEXT
from solver_backend.io.interpretation import interpret_cameras

FORMATS = (
    "Pose2Sim, anipose or caliscope .toml, Qualisys .qca.txt, Vicon .xcp, Metashape .xml, COLMAP's text model. "
    "OpenCV .yml, .yaml, .xml or .json, also of stereo pairs, multical, MC-Calib, Kalibr, ROS, Unity, Blender, Fit3D "
    "and OpenCap. NeRF's transforms.json, .npz of K, R and t, projection matrices or DLT numbers as text"
)
"""Names of all formats, for messages."""
_WHOLE: tuple[tuple[str, Callable[[Path], bool], Callable[[Path], StatedCameras]], ...] = (
    ("TOML", lambda path: path.suffix.lower() == ".toml", read_toml_cameras),
    ("Qualisys", lambda path: path.name.lower().endswith((".qca.txt", ".qca")), read_qualisys),
    ("Vicon", lambda path: path.suffix.lower() == ".xcp", read_vicon),
    ("Metashape", is_metashape, read_metashape),
    ("COLMAP", is_colmap, read_colmap),
)
"""Name, recogniser and reader of each format with all cameras in one file or folder. The most reliable comes first."""
_NEEDED = "an intrinsic matrix (K, camera_matrix, or fx, fy, cx, cy)", "a rotation and a translation"
"""Values that every camera needs, for messages."""
_MOST_FOLDERS = 64  # Largest number of camera folders to read in a calibration folder.


def read_calibration(path: Path | str, *, unit: str | None = None, up_axis: str | None = None) -> Calibration:
    """Read a calibration file, a folder of OpenCV files or a COLMAP text model.

    Args:
        unit: length unit of the file ('m', 'cm', 'mm', 'inch', 'foot'). None infers it.
        up_axis: up axis of the file's world ('z', 'y', '-y', ...). None uses the format's axis, or 'z'.

    Raises:
        CalibrationMissing: the path does not contain a calibration in a known format.
    """
    path = Path(path)
    files: list[MatrixFile] = []
    found = _of_program(path, unit, up_axis)
    if found is None and (path.is_dir() or path.suffix.lower() in READ):
        files = [read_matrix_file(p) for p in (_matrix_files(path.iterdir()) if path.is_dir() else [path])]
        found = _of_files(files, path, unit, up_axis)
    if found is None:
        if unknown := next(_not_understood(files), None):
            raise unknown
        hint = f"Supported formats: {FORMATS}."
        raise CalibrationMissing("No camera calibration was found.", where=str(path), hint=hint)
    return found


def calibrations_in(
    folder: Path, *, unit: str | None = None, up_axis: str | None = None, nested: bool = False
) -> tuple[list[Calibration], list[MocapError]]:
    """Read every calibration in a folder. Also return the errors for damaged, invalid or unknown files.

    Each TOML, Qualisys, Vicon or Metashape file is a calibration, and so is each OpenCV file with several cameras. The
    remaining OpenCV files together form one calibration. Other files are skipped.

    Args:
        nested: also read the subfolders, which belong to one camera each. If they all contain the same set of several
            file names, the files of each name form a calibration.
    """
    files = sorted(p for p in folder.iterdir() if not p.name.startswith("."))
    own = [folder, *(p for p in files if nested or not p.is_dir())]  # other folders may be other recordings
    whole = [p for _, recognises, _ in _WHOLE for p in own if recognises(p)]
    errors: list[MocapError] = []
    single: dict[str, list[MatrixFile]] = {"": []}
    groups: list[list[MatrixFile]] = []
    below = [p for p in files if p.is_dir()][:_MOST_FOLDERS] if nested else []
    inside = {p: _matrix_files(p.iterdir()) for p in below}
    stems = {tuple(path.stem for path in paths) for paths in inside.values() if paths}
    takes = len(stems) == 1 and len(stems.pop()) > 1
    for path in [*_matrix_files(files), *(path for paths in inside.values() for path in paths)]:
        if path in whole:
            continue
        try:
            file = read_matrix_file(path, nested=path.parent != folder)
        except (FileDamaged, CalibrationInvalid) as error:
            errors.append(error)
            continue
        if file.holds_array:
            groups.append([file])
        else:
            single.setdefault(path.stem if takes and path.parent != folder else "", []).append(file)
    found: list[Calibration | None] = []
    for read in (*whole, *groups, *single.values()):
        try:
            if isinstance(read, Path):
                found.append(_of_program(read, unit, up_axis))
            else:
                found.append(_of_files(read, folder, unit, up_axis))
        except (FileDamaged, CalibrationInvalid) as error:
            errors.append(error)
    if not any(found):
        errors += _not_understood(file for files in single.values() for file in files)
    return [calibration for calibration in found if calibration is not None], errors


def _matrix_files(paths: Iterable[Path]) -> list[Path]:
    known = (p for p in paths if p.suffix.lower() in READ and not p.name.startswith(".") and p.is_file())
    return sorted(p for p in known if p.stat().st_size <= LARGEST_TEXT)


def _not_understood(files: Iterable[MatrixFile]) -> Iterator[CalibrationMissing]:
    """Yield an error for each file that may be a calibration. The error lists its keys and the missing values."""
    for file in files:
        if file.keys or file.content.nodes:
            poses = [name for name, _ in file.content.nodes]
            held = f"the poses of {', '.join(poses)} without intrinsics" if poses else f"the keys {file.keys}"
            missing = _NEEDED[0] if poses else " with ".join(_NEEDED)
            what = f"The file was not recognised as a calibration. It has {held}. Each camera lacks {missing}."
            hint = f"Supported formats: {FORMATS}."
            yield CalibrationMissing(what, where=str(file.path), hint=hint)


def _of_program(path: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    """Read the calibration of a program in ``_WHOLE``, or return None for other files."""
    for kind, recognises, read in _WHOLE:
        if recognises(path):
            return interpret_cameras(read(path), path, kind, unit, up_axis)
    return None


def _of_files(files: Sequence[MatrixFile], folder: Path, unit: str | None, up_axis: str | None) -> Calibration | None:
    source = files[0].path if len(files) == 1 else folder
    return interpret_cameras(stated_cameras(files), source, "OpenCV", unit, up_axis)
