"""Read the path of a moving camera from files of camera trackers."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.exchange.errors import CalibrationInvalid, FrameCountMismatch
from solver_backend.exchange.outputs import require_path
from solver_backend.exchange.plausible import FARTHEST_IN_UNITS
from solver_backend.geometry.rotations import exp_so3, log_so3, matrix_from_quat
from solver_backend.io.files import LARGEST_TEXT, read_json, read_text

FRAMES, SECONDS, UNKNOWN = "frames", "seconds", "unknown"  # Time bases of paths.
ESTIMATED = "estimated_camera_path.txt"  # Name of a path estimated from the video background.
_GL = np.diag([1.0, -1.0, -1.0])  # From cameras with Y up that look along -Z (OpenGL, ARKit, Blender) to OpenCV's axes.
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_SAME_SPAN = 0.05  # Largest relative difference between the durations of a path and of its take.
_TICKS = (1.0, 1e-3, 1e-6, 1e-9)  # Possible units of time stamps, in seconds.
LOOSE_S = 0.1  # Largest difference in duration, in seconds, for a path with its own time base. Chosen by hand.
NEAREST_S = 0.5  # Largest time in seconds between a frame and its nearest pose. Chosen by hand.
_MATRICES = ("transform_matrix", "transform", "matrix", "camera_transform", "cameraTransform", "cameraPoseARFrame")
_PLACES, _TURNS = ("translation", "position", "t"), ("rotation", "orientation", "quaternion", "q")
_TIMES, _NUMBERS = ("timestamp", "time", "seconds"), ("frame", "frame_index", "frameNumber", "index")


_LATEST = 1e19  # Largest time stamp. It allows nanoseconds since 1970.
_SMALLEST = 1e-6  # Smallest norm of a quaternion, and smallest scale of a matrix, that defines a rotation.
_SHEARED = 0.01  # Largest relative deviation of a scaled rotation's columns from orthogonality. Chosen by hand.


@dataclass(frozen=True)
class StatedPath:
    """Camera poses as a file states them."""

    R: np.ndarray  # (N, 3, 3) rotations from the camera (OpenCV axes) to the file's world.
    centre: np.ndarray  # (N, 3) camera positions in the file's unit.
    at: np.ndarray  # (N,) frame numbers or time stamps (seconds) of the poses, increasing.
    clock: str  # ``FRAMES``, ``SECONDS`` or ``UNKNOWN``.
    metres: float = 0.0  # Metres per length unit, 0 if unknown.
    up: np.ndarray | None = None  # (3,) up direction in the file's world, or None if unknown.


@dataclass(frozen=True)
class PathFormat:
    """A supported file format for camera paths."""

    name: str
    recognises: Callable[[Path], bool]
    read: Callable[[Path], StatedPath]


@dataclass(frozen=True)
class FilmedPath:
    """Camera poses for the F frames of a take, in the file's world coordinates and length unit."""

    R: np.ndarray  # (F, 3, 3).
    centre: np.ndarray  # (F, 3) camera positions.
    metres: float
    up: np.ndarray | None
    source: str  # Name of the file.


def read_camera_path(path: Path | str, frames: int, fps: float) -> FilmedPath:
    """Read the camera pose of each frame of a take. Short gaps between poses are interpolated.

    Raises:
        CalibrationInvalid: no reader recognises the file, or its numbers are invalid.
        FrameCountMismatch: the poses belong to another video.
    """
    path = Path(path)
    require_path(path, "camera path")
    reader = next((row for row in FORMATS if row.recognises(path)), None)
    if reader is None:
        hint = f"Supported formats: {', '.join(row.name for row in FORMATS)}."
        raise CalibrationInvalid("The file has no camera path in a known format.", where=str(path), hint=hint)
    stated = reader.read(path)
    if len(np.unique(stated.at)) < 2:
        raise CalibrationInvalid("The camera path has fewer than two poses.", where=str(path))
    at = _frames_of(stated, frames, fps, path)
    order = np.unique(at, return_index=True)[1]
    at, R, centre = at[order], stated.R[order], stated.centre[order]
    number = np.arange(frames)
    after = np.clip(np.searchsorted(at, number), 1, len(at) - 1)
    far = np.minimum(np.abs(at[after] - number), np.abs(number - at[after - 1]))
    if far.max() > NEAREST_S * fps:
        first = int(np.argmax(far > NEAREST_S * fps))
        what = (
            f"The camera path has no pose near frame {first} of {frames}. It covers frames {at[0]:.0f} to {at[-1]:.0f}."
        )
        hint = "Track the whole video, or solve only the tracked frames with --frames."
        raise FrameCountMismatch(what, where=str(path), hint=hint)
    share = np.clip((number - at[after - 1]) / (at[after] - at[after - 1]), 0.0, 1.0)[:, None]
    turn = log_so3(R[after] @ R[after - 1].swapaxes(-1, -2))
    R = exp_so3(share * turn) @ R[after - 1]
    centre = (1.0 - share) * centre[after - 1] + share * centre[after]
    return FilmedPath(R, centre, stated.metres, stated.up, path.name)


def _frames_of(stated: StatedPath, frames: int, fps: float, path: Path) -> np.ndarray:
    """Assign each pose to a frame of the take, counted from 0.

    Frame numbers count from 0 or 1. If a number exceeds the take's length, the first pose belongs to the first frame.
    If all time stamps lie within the take, they count from its start, because a tracker may start late. Otherwise, the
    first time stamp belongs to the first frame.
    """
    at, last = stated.at, max(frames - 1, 1)
    units = (1.0, *(fps * tick for tick in _TICKS if stated.clock == SECONDS))
    unit = min(units, key=lambda unit: abs(unit * (at[-1] - at[0]) / last - 1.0))
    if stated.clock == FRAMES or (stated.clock == SECONDS and unit == 1.0 and at[-1] <= frames):
        from_zero = at[0] < 1.0 or (at[0] > 1.0 and at[-1] == last)
        return at - (at[0] if at[-1] >= frames + 1 else 0.0 if from_zero else 1.0)
    number = unit * at
    beyond = float(number[-1] - number[0]) - last
    hint = "Provide the path for this video, with a time or a frame number for each pose."
    if abs(beyond) > _SAME_SPAN * last:
        long = f"{at[-1] - at[0]:g} s" if stated.clock == SECONDS else f"{at[-1] - at[0] + 1:g} poses"
        what = f"The camera path is {long} long, but the take has {frames} frames in {frames / fps:.1f} s."
        raise FrameCountMismatch(what, where=str(path), hint=hint)
    if stated.clock == SECONDS and beyond < -0.5 and number[0] >= 0.0 and number[-1] <= last + 0.5:
        return number
    if abs(beyond) > max(LOOSE_S * fps, 1.5):
        many = f"{abs(beyond):.0f} frames {'longer' if beyond > 0 else 'shorter'}"
        what = f"The camera path is {many} than the take, and no time or frame number shows where it begins."
        hint = "Number the poses by video frames from 0, or add their times since the first frame."
        raise FrameCountMismatch(what, where=str(path), hint=hint)
    return number - number[0]


def _lines(path: Path) -> list[list[str]]:
    rows = (line.strip() for line in read_text(path, LARGEST_TEXT).splitlines())
    return [row.replace(",", " ").split() for row in rows if row and not row.startswith("#")]


def _is_number(word: str) -> bool:
    return re.fullmatch(r"[-+.\deE]+", word) is not None


def _numbers(rows: Sequence[Sequence[str]], path: Path) -> np.ndarray:
    try:
        return _array([[float(cell) for cell in row] for row in rows], _LATEST)
    except ValueError as error:
        raise CalibrationInvalid(f"A value of the camera path is not a number: {error}.", where=str(path)) from error


def _array(values: Any, most: float = FARTHEST_IN_UNITS) -> np.ndarray:
    """Convert values to an array. Raise ``ValueError`` if a value is not finite or exceeds ``most``."""
    try:
        array = np.array(values, dtype=float)
    except OverflowError as error:
        raise ValueError("a number is too large") from error
    if not (np.abs(array) <= most).all():
        raise ValueError(f"a number is beyond {most:g} or missing")
    return array


def _turns(quats: np.ndarray, path: Path) -> np.ndarray:
    """Convert (N, 4) quaternions w, x, y, z of any norm to (N, 3, 3) rotations."""
    if not (np.linalg.norm(quats, axis=-1) > _SMALLEST).all():
        raise CalibrationInvalid("A rotation of the camera path is zero.", where=str(path))
    return np.asarray(matrix_from_quat(_unit(quats)))


def _images_of(path: Path) -> Path:
    """Return the ``images.txt`` of a COLMAP folder, or the given path."""
    found = [path / part / "images.txt" for part in (".", "0", "sparse", "sparse/0")] if path.is_dir() else [path]
    return next((file for file in found if file.is_file()), path)


def _is_colmap(path: Path) -> bool:
    file = _images_of(path)
    return file.is_file() and file.name.lower() == "images.txt"


def _read_colmap(path: Path) -> StatedPath:
    """Read the image lines of a COLMAP text model. Numbers in image names are frame numbers."""
    file = _images_of(path)
    # Lines of points consist of triples of numbers.
    rows = [row for row in _lines(file) if len(row) == 10 or (len(row) > 10 and not _is_number(row[-1]))]
    names = [re.findall(r"\d+", Path(" ".join(row[9:])).stem) for row in rows]
    if not rows or not all(names):
        hint = "Number the images, such as frame_000001.png, or export the model as text."
        raise CalibrationInvalid("The images of the COLMAP model have no frame numbers.", where=str(file), hint=hint)
    values = _numbers([row[1:8] for row in rows], file)
    R = _turns(values[:, :4], file).swapaxes(-1, -2)
    at = _numbers([parts[-1:] for parts in names], file)[:, 0]
    return _sorted(R, -np.einsum("nab,nb->na", R, values[:, 4:]), at, FRAMES)


def _is_trajectory(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in (".txt", ".tum", ".csv", ".freiburg"):
        return False
    rows = _lines(path)[:2]
    return bool(rows) and all(len(row) == 8 and all(map(_is_number, row)) for row in rows)


def _read_trajectory(path: Path) -> StatedPath:
    """Read a TUM trajectory: ``timestamp tx ty tz qx qy qz qw`` per line, from camera to world."""
    rows = _lines(path)
    if any(len(row) != 8 for row in rows):
        raise CalibrationInvalid("A line of the camera path does not have eight numbers.", where=str(path))
    values = _numbers(rows, path)
    R = _turns(values[:, [7, 4, 5, 6]], path)
    return _sorted(R, values[:, 1:4], values[:, 0], SECONDS)


def _read_document(path: Path) -> StatedPath:
    """Read a JSON list of poses, or an object with such a list under ``frames`` or ``poses``.

    A pose is a camera-to-world matrix, or a position and a quaternion x, y, z, w. AR sessions (ARKit, ARCore, Record3D)
    are in metres with Y up. The object may state ``axes`` ("opengl" or "opencv"), ``up`` and ``metres_per_unit``.
    """
    document = read_json(path)
    poses = document.get("frames", document.get("poses")) if isinstance(document, dict) else document
    about = document if isinstance(document, dict) else {}
    try:
        parsed = [_pose(pose, path) for pose in poses or ()]
        metres, up = about.get("metres_per_unit"), about.get("up")
        metres = None if metres is None else float(_array(metres))
        if metres is not None and metres < 0.0:
            raise ValueError("metres_per_unit is negative")
        axes = str(about.get("axes", "opengl")).lower()
        if axes not in ("opengl", "opencv"):
            raise ValueError(f"the axes '{axes}' are neither opengl nor opencv")
        up = None if up is None else _array(_AXES[up.lower()] if isinstance(up, str) else up).reshape(1, 3)
        if up is not None and not up.any():
            raise ValueError("the direction up is zero")
        up = None if up is None else _unit(up)[0]
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise CalibrationInvalid(f"A pose of the camera path is not valid: {error}.", where=str(path)) from error
    if not parsed:
        raise CalibrationInvalid("The document lists no poses under 'frames' or 'poses'.", where=str(path))
    R, centre = np.stack([one[0] for one in parsed]), np.stack([one[1] for one in parsed])
    if axes != "opencv":
        R = R @ _GL
    session = "file_path" not in str(poses[0]) and "axes" not in about
    metres, up = (1.0, np.array(_AXES["y"])) if session and metres is None and up is None else (metres or 0.0, up)
    clocks = {one[3] for one in parsed}
    clock = clocks.pop() if len(clocks) == 1 else UNKNOWN
    at = np.array([one[2] for one in parsed]) if clock != UNKNOWN else np.arange(len(parsed), dtype=float)
    return _sorted(R, centre, at, clock, metres, up)


def _pose(pose: Any, path: Path) -> tuple[np.ndarray, np.ndarray, float, str]:
    """Return a pose's rotation, position, time stamp or frame number, and time base."""
    if not isinstance(pose, Mapping):
        values = _array(pose)
        if values.shape == (7,):  # Record3D: a quaternion and a position
            return _turns(values[None, [3, 0, 1, 2]], path)[0], values[4:], 0.0, UNKNOWN
        return *_of_matrix(values), 0.0, UNKNOWN
    key = next((key for key in _MATRICES if key in pose), None)
    if key is not None:
        R, centre = _of_matrix(_array(pose[key]))
    else:
        place, turn = (next((key for key in keys if key in pose), keys[0]) for keys in (_PLACES, _TURNS))
        centre, q = _vector(pose[place], "xyz"), _vector(pose[turn], "xyzw")
        R = _turns(q[None, [3, 0, 1, 2]], path)[0]
    for keys, clock in ((_NUMBERS, FRAMES), (_TIMES, SECONDS)):
        if (key := next((key for key in keys if key in pose), None)) is not None:
            return R, centre, float(_array(pose[key], _LATEST)), clock
    digits = re.findall(r"\d+", Path(str(pose.get("file_path", ""))).stem)
    return R, centre, float(_array(float(digits[-1]), _LATEST)) if digits else 0.0, FRAMES if digits else UNKNOWN


def _of_matrix(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split a camera-to-world matrix of 16 numbers, by rows or by columns, into rotation and position."""
    M = values.reshape(4, 4)
    M = M.T if np.allclose(M[:3, 3], 0.0) and not np.allclose(M[3, :3], 0.0) else M
    size = np.cbrt(abs(np.linalg.det(M[:3, :3])))
    if not (size > _SMALLEST and np.abs(M[:3, :3] @ M[:3, :3].T - size**2 * np.eye(3)).max() < _SHEARED * size**2):
        raise ValueError("a matrix has no rotation")
    return M[:3, :3] / size, M[:3, 3]


def _vector(values: Any, names: str) -> np.ndarray:
    return _array([values[name] for name in names] if isinstance(values, Mapping) else values).reshape(len(names))


def _unit(q: np.ndarray) -> np.ndarray:
    return q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-12)


def _sorted(
    R: np.ndarray,
    centre: np.ndarray,
    at: Sequence[float] | np.ndarray,
    clock: str,
    metres: float = 0.0,
    up: np.ndarray | None = None,
) -> StatedPath:
    order = np.argsort(at, kind="stable")
    return StatedPath(R[order], centre[order], np.asarray(at, dtype=float)[order], clock, metres, up)


FORMATS = (
    PathFormat("a COLMAP model as text (images.txt)", _is_colmap, _read_colmap),
    PathFormat(
        "a trajectory with 'time tx ty tz qx qy qz qw' per line (TUM, DROID-SLAM)", _is_trajectory, _read_trajectory
    ),
    PathFormat("JSON of ARKit, ARCore or Blender", lambda path: path.suffix.lower() == ".json", _read_document),
)
"""Supported formats, tried in this order."""
