"""NumPy arrays of points: (frames, K, 2 or 3) or (frames, people, K, 2 or 3) a camera, x, y and score.

All cameras together are an array with one axis more, cameras first, or an archive of an array a camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tokenize import TokenError

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.exchange.npz import array_names, read_npz
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.types import JointSet

_LARGEST_SCORE = 1.5
"""A third number is a score up to here, and a place in space beyond."""


MOST_CAMERAS, MOST_PEOPLE = 64, 12
"""Of four axes the first is the cameras' where it has no more than these, and the second more than people are kept."""


def is_array(path: Path) -> bool:
    """Whether a file holds arrays of as many points as a joint set has, whose third number, if any, is a score."""
    try:
        arrays = list(_arrays(path).values())
    except FileDamaged:
        return False
    scored = [array[..., 2] for array in arrays if array.shape[-1] == 3]
    return bool(arrays) and all(float(np.nanmax(np.abs(s), initial=0.0)) <= _LARGEST_SCORE for s in scored)


def cameras_in(path: Path) -> dict[str, Callable[[], CameraFrames]]:
    """Return the cameras of a file that holds all of them, and how each is read; none where it is one camera's.

    The cameras of an array have no names: they are ``cam01``, ``cam02`` and so on.

    Raises:
        FileDamaged: it is no such file.
    """
    arrays = _arrays(path)
    if len(arrays) == 1:
        (array,) = arrays.values()
        some, many = array.shape[0] <= MOST_CAMERAS, array.shape[1] > MOST_PEOPLE
        if array.ndim < 4 or (array.ndim == 4 and not (some and many)):
            return {}
        arrays = {f"cam{c + 1:02d}": camera for c, camera in enumerate(array)}
    return {name: partial(_frames, array, path) for name, array in arrays.items()}


def read_array(path: Path) -> CameraFrames:
    """Return the frames of one camera; without scores a point is sure where it is there and not (0, 0).

    Raises:
        FileDamaged: it is no array of one camera.
    """
    (array, *others) = _arrays(path).values()
    if others or array.ndim > 4:
        hint = "Read it alone, or write one array a camera."
        raise FileDamaged("The file holds several cameras beside files of one.", where=str(path), hint=hint)
    return _frames(array, path)


def _frames(array: np.ndarray, path: Path) -> CameraFrames:
    array = np.array(array, dtype=np.float64)
    array = array[:, None] if array.ndim == 3 else array
    xy = array[..., :2]
    there = np.isfinite(xy).all(-1) & (xy != 0).any(-1)
    score = np.where(there, array[..., 2] if array.shape[-1] == 3 else 1.0, 0.0)
    points = np.concatenate([xy, score[..., None]], axis=-1)
    frames = {f: [person for person in people if (person[:, 2] > 0).any()] for f, people in enumerate(points)}
    return CameraFrames.in_memory(frames, path)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file by name, '' for that of a .npy."""
    if path.suffix.lower() == ".npz":
        if not 1 < len(array_names(path)) <= MOST_CAMERAS:
            hint = f"Save 2 to {MOST_CAMERAS} arrays of (frames, K, 3), each by its camera's name."
            raise FileDamaged("The archive holds no array a camera.", where=str(path), hint=hint)
        return {name: _checked(array, path) for name, array in read_npz(path).items()}
    if path.suffix.lower() != ".npy":
        raise FileDamaged("The file is not a NumPy array.", where=str(path))
    try:
        return {"": _checked(np.load(path, mmap_mode="r", allow_pickle=False), path)}
    except (OSError, ValueError, EOFError, SyntaxError, TokenError, OverflowError, MemoryError) as error:
        raise FileDamaged(f"The file is not a NumPy array ({error}).", where=str(path)) from error


def _checked(array: np.ndarray, path: Path) -> np.ndarray:
    counts = {count for s in JointSet for count in s.num_written}
    if array.ndim not in (3, 4, 5) or array.shape[-1] not in (2, 3) or array.shape[-2] not in counts or not array.size:
        raise FileDamaged(f"The array has the shape {array.shape}; (frames, points, 3) is expected.", where=str(path))
    if array.dtype.kind not in "fiu":
        raise FileDamaged(f"The array holds {array.dtype}, not numbers.", where=str(path))
    return array


RAW_DATA = ("output_data/raw_data", "output_data/raw-data", "DataArrays")
"""Folders of a FreeMoCap recording that hold the array, of today's and of earlier versions."""
BODY_POINTS = 33
"""MediaPipe's body; the right hand, the left hand and the face follow."""
_HANDS = (BODY_POINTS + NUM_HAND_POINTS, BODY_POINTS)
"""First points of the left and of the right hand."""


def find_array(root: Path) -> Path | None:
    """Return the array of 2D points in a FreeMoCap recording's folder, None where there is none."""
    folders = [folder for name in RAW_DATA if (folder := root / name).is_dir()]
    found = [p for folder in folders for p in sorted(folder.iterdir()) if p.suffix == ".npy" and "2ddata" in _plain(p)]
    return found[0] if found else None


def camera_names(root: Path, path: Path) -> tuple[str, ...]:
    """Return the names of an array's cameras: of the recording's videos, or as FreeMoCap numbers them.

    Raises:
        FileDamaged: it is no array of 2D points.
    """
    count, videos = len(_array(path)), root / "synchronized_videos"
    named = sorted(p.stem for p in videos.iterdir() if p.suffix.lower() == ".mp4") if videos.is_dir() else []
    return tuple(named) if len(named) == count else tuple(f"Camera_{c:03d}_synchronized" for c in range(count))


def read_camera(path: Path, camera: int) -> CameraFrames:
    """Return the frames of one camera of an array, by its place in it.

    Raises:
        FileDamaged: it is no array of 2D points.
    """
    array = _array(path)
    points = np.array(array[camera, :, : BODY_POINTS + 2 * NUM_HAND_POINTS], dtype=np.float64)
    confidence = points[..., 2] if points.shape[-1] == 3 else np.isfinite(points).all(-1).astype(np.float64)
    people = np.concatenate([points[..., :2], confidence[..., None]], axis=-1)
    seen = (people[:, :BODY_POINTS, 2] > 0).any(axis=1)
    frames = CameraFrames.in_memory({f: [p[:BODY_POINTS]] if seen[f] else [] for f, p in enumerate(people)}, path)
    if people.shape[1] < BODY_POINTS + 2 * NUM_HAND_POINTS:
        return frames
    hands = np.stack([people[:, first : first + NUM_HAND_POINTS] for first in _HANDS], axis=1)
    return replace(frames, hands=lambda row: [hands[row]] if seen[row] else [])


def _array(path: Path) -> np.ndarray:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise FileDamaged(f"The array cannot be read ({error}).", where=str(path)) from error
    if array.ndim != 4 or array.shape[2] < BODY_POINTS or array.shape[3] not in (2, 3) or array.dtype.kind != "f":
        what = f"The array has the shape {array.shape}; (cameras, frames, {BODY_POINTS} points or more, 2) is expected."
        raise FileDamaged(what, where=str(path))
    return array


def _plain(path: Path) -> str:
    return path.stem.lower().replace("_", "")
