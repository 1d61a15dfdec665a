"""NumPy arrays of one camera's points: (frames, K, 2 or 3) or (frames, people, K, 2 or 3), x, y and score."""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.detections.camera_frames import CameraFrames
from solver_backend.types import JointSet

_LARGEST_SCORE = 1.5
"""A third number is a score up to here, and a place in space beyond."""


def is_array(path: Path) -> bool:
    """Whether a file is an array of as many points as a joint set has, whose third number, if any, is a score."""
    if path.suffix.lower() != ".npy":
        return False
    try:
        array = _array(path)
    except FileDamaged:
        return False
    return array.shape[-1] == 2 or float(np.nanmax(np.abs(array[..., 2]), initial=0.0)) <= _LARGEST_SCORE


def read_array(path: Path) -> CameraFrames:
    """Return the frames of one camera; without scores a point is sure where it is there and not (0, 0).

    Raises:
        FileDamaged: it is no such array.
    """
    array = np.array(_array(path), dtype=np.float64)
    array = array[:, None] if array.ndim == 3 else array
    xy = array[..., :2]
    there = np.isfinite(xy).all(-1) & (xy != 0).any(-1)
    score = np.where(there, array[..., 2] if array.shape[-1] == 3 else 1.0, 0.0)
    points = np.concatenate([xy, score[..., None]], axis=-1)
    frames = {f: [person for person in people if (person[:, 2] > 0).any()] for f, people in enumerate(points)}
    return CameraFrames.in_memory(frames, path)


def _array(path: Path) -> np.ndarray:
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError, SyntaxError, TokenError, OverflowError, MemoryError) as error:
        raise FileDamaged(f"The file is not a NumPy array ({error}).", where=str(path)) from error
    counts = {count for s in JointSet for count in s.num_written}
    if array.ndim not in (3, 4) or array.shape[-1] not in (2, 3) or array.shape[-2] not in counts or not array.size:
        raise FileDamaged(f"The array has the shape {array.shape}; (frames, points, 3) is expected.", where=str(path))
    if array.dtype.kind not in "fiu":
        raise FileDamaged(f"The array holds {array.dtype}, not numbers.", where=str(path))
    return array
