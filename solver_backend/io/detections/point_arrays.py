"""NumPy arrays of points: (frames, K, 2 or 3) or (frames, people, K, 2 or 3) a camera, x, y and score.

All cameras together are an array with one axis more, cameras first, or an archive of an array a camera.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tokenize import TokenError

import numpy as np

from solver_backend.exchange.errors import FileDamaged
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
        raise FileDamaged(
            "The file holds several cameras beside files of one.", where=str(path),
            hint="Read it alone, or write one array a camera.",
        )  # fmt: skip
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
    """Return the arrays of a file by name, '' for that of a .npy.

    Raises:
        FileDamaged: it holds something else.
    """
    if path.suffix.lower() == ".npz":
        if not 1 < len(array_names(path)) <= MOST_CAMERAS:
            raise FileDamaged(
                "The archive holds no array a camera.", where=str(path),
                hint=f"Save 2 to {MOST_CAMERAS} arrays of (frames, K, 3), each by its camera's name.",
            )  # fmt: skip
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
