"""NumPy arrays of points: (frames, K, 2 or 3) or (frames, people, K, 2 or 3) a camera, x, y and score.

All cameras together are an array with one axis more, cameras first, or an archive of an array a camera.
"""

from __future__ import annotations

import io
import json
import pickle
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from solver_backend.exchange.errors import BackendMissing, FileDamaged, MocapError
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.exchange.npz import array_names, read_npz
from solver_backend.exchange.outputs import open_regular
from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.detections.column_table import frames_of_columns
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


_MAGIC = b"\x89HDF\r\n\x1a\n"


@contextmanager
def opened(path: Path, program: str) -> Iterator[Any]:
    """Open a file; what it lacks inside the block becomes one of our errors.

    Args:
        program: that wrote it, for messages.

    Raises:
        BackendMissing: h5py is not installed.
        FileDamaged: it is no HDF5 file, is truncated, or is not as the program writes it.
    """
    try:
        h5py = import_module("h5py")
    except ModuleNotFoundError as error:
        what = f"{program}'s HDF5 files are read with h5py, which is not installed."
        raise BackendMissing(what, where=str(path), hint="Install it with: pip install h5py.") from error
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise FileDamaged(f"The file is not an HDF5 file, or is truncated ({error}).", where=str(path)) from error
    with file:
        try:
            yield file
        except MocapError:
            raise
        except (KeyError, ValueError, IndexError, TypeError, OSError, RecursionError, AttributeError) as error:
            what = f"The file is not as {program} writes it ({error})."
            raise FileDamaged(what, where=str(path), hint=f"Export it from {program} again.") from error


def begins_with(path: Path, text: bytes, length: int) -> bool:
    """Whether the first bytes of an HDF5 file, so many, hold a text, such as the name of a group."""
    try:
        with open_regular(path) as file:
            start = file.read(length)
    except OSError:
        return False
    return start.startswith(_MAGIC) and text in start


_GROUP = b"df_with_missing"
"""Name of the table that DeepLabCut writes."""
_START_BYTES = 1 << 16
_LEVELS = (3, 4)
"""Of column names: scorer, individuals (where there are several), bodyparts, coords."""


def is_hdf5_table(path: Path) -> bool:
    """Whether a file is named, or begins, as DeepLabCut's tables do."""
    name = path.name.lower()
    return name.endswith((".h5", ".hdf5")) and ("dlc" in name or begins_with(path, _GROUP, _START_BYTES))


def read_hdf5_table(path: Path) -> CameraFrames:
    """Return the frames of one camera.

    Raises:
        BackendMissing: h5py is not installed.
        FileDamaged: it is no such table, or its column names hold anything but texts.
    """
    with opened(path, "DeepLabCut") as file:
        table = next(group["table"] for group in file.values() if "table" in group)
        rows = table[()]
        blocks = [name for name in rows.dtype.names if name.startswith("values_block_")]
        columns = [tuple(column) for name in blocks for column in _texts_in(table.attrs[f"{name}_kind"])]
        values = np.concatenate([np.asarray(rows[name], np.float64).reshape(len(rows), -1) for name in blocks], axis=1)
        if {len(column) for column in columns} - set(_LEVELS) or values.shape[1] != len(columns):
            raise ValueError(f"{values.shape[1]} columns have {len(columns)} names")
        people = [str(column[1]) if len(column) == _LEVELS[1] else "single" for column in columns]
        parts, coords = [str(column[-2]) for column in columns], [str(column[-1]).lower() for column in columns]
        return frames_of_columns([int(n) for n in rows["index"]], values, people, parts, coords, path)


def _texts_in(pickled: Any) -> list[Any]:
    """Return a pickled list of tuples of texts; nothing else is made, and no code is run."""
    try:
        found = _PlainUnpickler(io.BytesIO(bytes(pickled))).load()
    except (pickle.UnpicklingError, EOFError, MemoryError) as error:
        raise ValueError(f"its column names are not a list of texts: {error}") from error
    if not isinstance(found, list) or not all(isinstance(c, tuple) and all(map(_is_text, c)) for c in found):
        raise ValueError("its column names are not a list of texts")
    return found


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


class _PlainUnpickler(pickle.Unpickler):
    """Makes lists, tuples, texts and numbers alone: every class and function is refused by name."""

    def find_class(self, module_name: str, global_name: str, /) -> Any:
        """Refuse.

        Raises:
            UnpicklingError: always.
        """
        raise pickle.UnpicklingError(f"{module_name}.{global_name}")


_NAME = re.compile(r"(labels\.v\d+\.)?(\d+_)?(?P<camera>.+?)(\.predictions)?(\.analysis)?", re.IGNORECASE)
"""``labels.v001.000_cam01.analysis.h5`` is of ``cam01``."""
_PREDICTED = 1
"""``instance_type`` of a prediction; 0 is of a person who clicked it, whose points have no score."""


def is_sleap(path: Path) -> bool:
    """Whether a file's name is one that SLEAP gives."""
    return path.name.lower().endswith((".analysis.h5", ".slp"))


def sleap_camera(path: Path) -> str:
    """Return the video's name in the file's."""
    found = _NAME.fullmatch(path.name.rpartition(".")[0])
    return found["camera"] if found else path.stem


def read_sleap(path: Path) -> CameraFrames:
    """Return the frames of one camera.

    Raises:
        BackendMissing: h5py is not installed.
        FileDamaged: it is no such file, or holds several videos.
    """
    with opened(path, "SLEAP") as file:
        names, frames = (_labels if path.suffix.lower() == ".slp" else _analysis)(file)
    return CameraFrames.in_memory(frames, path, names)


def _analysis(file: Any) -> tuple[tuple[str, ...], dict[int, People]]:
    """Read ``tracks`` (tracks, 2, nodes, frames) with ``point_scores`` (tracks, nodes, frames)."""
    names = _texts(file["node_names"][()])
    tracks = np.asarray(file["tracks"][()], dtype=np.float64)
    if tracks.ndim != 4 or tracks.shape[1:3] != (2, len(names)):
        raise ValueError(f"tracks has the shape {tracks.shape}")
    seen = np.isfinite(tracks).all(axis=1)
    scores = np.asarray(file["point_scores"][()], dtype=np.float64) if "point_scores" in file else seen * 1.0
    confidence = np.where(seen & (scores > 0), np.minimum(scores, 1.0), 0.0)
    xy = np.moveaxis(tracks, (3, 0, 2, 1), (0, 1, 2, 3))
    points = np.concatenate([xy, np.moveaxis(confidence, 2, 0)[..., None]], axis=-1)
    return names, {f: [person for person in people if (person[:, 2] > 0).any()] for f, people in enumerate(points)}


def _labels(file: Any) -> tuple[tuple[str, ...], dict[int, People]]:
    """Read ``frames``, ``instances`` and the points of each, ``pred_points`` with scores or ``points`` without."""
    about = json.loads(file["metadata"].attrs["json"])
    order = [node["id"] for node in about["skeletons"][0]["nodes"]]
    names = tuple(str(about["nodes"][i]["name"]) for i in order)
    table, instances = file["frames"][()], file["instances"][()]
    if len(np.unique(table["video"])) > 1:
        raise ValueError("it holds several videos: export an analysis file of each")
    points = {True: file["pred_points"][()], False: file["points"][()]}
    frames: dict[int, People] = {}
    for row in table:
        here = range(int(row["instance_id_start"]), int(row["instance_id_end"]))
        corrected = {int(instances[i]["from_predicted"]) for i in here}
        people = [_person(instances[i], points) for i in here if i not in corrected]
        frames[int(row["frame_idx"])] = [p for p in people if len(p) == len(names) and (p[:, 2] > 0).any()]
    return names, frames


def _person(instance: np.void, points: dict[bool, np.ndarray]) -> np.ndarray:
    """Return (K, 3) of an instance; what a person clicked is sure."""
    predicted = int(instance["instance_type"]) == _PREDICTED
    rows = points[predicted][int(instance["point_id_start"]) : int(instance["point_id_end"])]
    seen = rows["visible"] & np.isfinite(rows["x"]) & np.isfinite(rows["y"])
    score = np.minimum(rows["score"], 1.0) if predicted else np.ones(len(rows))
    return np.column_stack([rows["x"], rows["y"], np.where(seen, score, 0.0)]).astype(np.float64)


def _texts(values: np.ndarray) -> tuple[str, ...]:
    return tuple(v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in values.tolist())
