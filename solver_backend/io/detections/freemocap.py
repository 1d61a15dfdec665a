"""FreeMoCap's array of all cameras: (cameras, frames, points, 2 or 3), MediaPipe's 33 body points first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.io.detections.camera_frames import CameraFrames

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
        raise FileDamaged(
            f"The array has the shape {array.shape}; (cameras, frames, {BODY_POINTS} points or more, 2) is expected.",
            where=str(path),
        )
    return array


def _plain(path: Path) -> str:
    return path.stem.lower().replace("_", "")
