"""Read detections from NumPy arrays, also FreeMoCap's, and from HDF5 files of DeepLabCut and SLEAP."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.files.restricted_pickle import Machine
from solver_backend.exchange.errors import BackendMissing, FileDamaged, MocapError, UnsafePickle
from solver_backend.exchange.joint_sets import NUM_HAND_POINTS
from solver_backend.exchange.npz import array_names, read_npz
from solver_backend.io.detections.camera_frames import CameraFrames, is_seen
from solver_backend.io.detections.column_table import frames_of_columns
from solver_backend.io.files import first_bytes, load_array
from solver_backend.types import JointSet

# NumPy arrays of one camera contain x, y and score: (frames, K, 2 or 3) or (frames, people, K, 2 or 3). Several cameras
# are an array with a leading camera axis, or an archive with one array per camera.
_LARGEST_SCORE = 1.5  # A larger third number is a 3D coordinate rather than a score.
MOST_CAMERAS, MOST_PEOPLE = 64, 12
"""Largest numbers of cameras and people, which distinguish the first axes of an array with four axes."""


def is_array(path: Path) -> bool:
    """Return whether a file contains arrays of 2D points whose number of points matches a joint set."""
    try:
        arrays = list(_arrays(path).values())
    except FileDamaged:
        return False
    scored = [array[..., 2] for array in arrays if array.shape[-1] == 3]
    return bool(arrays) and all(float(np.nanmax(np.abs(s), initial=0.0)) <= _LARGEST_SCORE for s in scored)


def cameras_in(path: Path) -> dict[str, Callable[[], CameraFrames]]:
    """Return a reader for each camera in a file, or {} for a single camera.

    An array does not name its cameras. They are called ``cam01``, ``cam02`` and so on.
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
    """Read the array of one camera. The confidence is 1 if there are no scores."""
    (array, *others) = _arrays(path).values()
    if others or array.ndim > 4:
        hint = "Read it alone, or write one array per camera."
        raise FileDamaged("One file has several cameras, but the others have one.", where=str(path), hint=hint)
    return _frames(array, path)


def _frames(array: np.ndarray, path: Path) -> CameraFrames:
    array = np.array(array, dtype=np.float64)
    array = array[:, None] if array.ndim == 3 else array
    xy = array[..., :2]
    there = np.isfinite(xy).all(-1) & (xy != 0).any(-1)
    score = np.where(there, array[..., 2] if array.shape[-1] == 3 else 1.0, 0.0)
    return CameraFrames.of_array(np.concatenate([xy, score[..., None]], axis=-1), path)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """Load the arrays in a file by name. The array in a .npy file has the name ''."""
    if path.suffix.lower() == ".npz":
        if not 1 < len(array_names(path)) <= MOST_CAMERAS:
            hint = f"Save 2 to {MOST_CAMERAS} arrays of shape (frames, K, 3), each named after its camera."
            raise FileDamaged("The archive does not contain one array per camera.", where=str(path), hint=hint)
        return {name: _checked(array, path) for name, array in read_npz(path).items()}
    if path.suffix.lower() != ".npy":
        raise FileDamaged("The file is not a NumPy array.", where=str(path))
    return {"": _checked(load_array(path), path)}


def _checked(array: np.ndarray, path: Path) -> np.ndarray:
    counts = {count for s in JointSet for count in s.num_written}
    if array.ndim not in (3, 4, 5) or array.shape[-1] not in (2, 3) or array.shape[-2] not in counts or not array.size:
        raise FileDamaged(
            f"The array has the shape {array.shape}, but (frames, points, 3) is expected.", where=str(path)
        )
    if array.dtype.kind not in "fiu":
        raise FileDamaged(f"The array contains {array.dtype}, not numbers.", where=str(path))
    return array


# FreeMoCap: (cameras, frames, points, 2 or 3) MediaPipe points.
RAW_DATA = ("output_data/raw_data", "output_data/raw-data", "DataArrays")
"""Folders of a recording that contain the array, in current and older versions."""
BODY_POINTS = 33  # Number of MediaPipe body points. They are followed by the right hand, the left hand and the face.
_HANDS = (BODY_POINTS + NUM_HAND_POINTS, BODY_POINTS)  # Index of the first point of the left and right hand.


def find_array(root: Path) -> Path | None:
    """Find the array of 2D points in a FreeMoCap recording, or return None."""
    folders = [folder for name in RAW_DATA if (folder := root / name).is_dir()]
    arrays = (p for folder in folders for p in sorted(folder.iterdir()) if p.suffix == ".npy")
    return next((p for p in arrays if "2ddata" in p.stem.lower().replace("_", "")), None)


def camera_names(root: Path, path: Path) -> tuple[str, ...]:
    """Return the camera names of a FreeMoCap array: the video names, or else FreeMoCap's default names."""
    count, videos = len(_recorded(path)), root / "synchronized_videos"
    named = sorted(p.stem for p in videos.iterdir() if p.suffix.lower() == ".mp4") if videos.is_dir() else []
    return tuple(named) if len(named) == count else tuple(f"Camera_{c:03d}_synchronized" for c in range(count))


def read_camera(path: Path, camera: int) -> CameraFrames:
    """Read one camera's body and hands from a FreeMoCap array."""
    points = np.array(_recorded(path)[camera, :, : BODY_POINTS + 2 * NUM_HAND_POINTS], dtype=np.float64)
    confidence = points[..., 2] if points.shape[-1] == 3 else np.isfinite(points).all(-1).astype(np.float64)
    people = np.concatenate([points[..., :2], confidence[..., None]], axis=-1)
    frames = CameraFrames.of_array(people[:, None, :BODY_POINTS], path)
    if people.shape[1] < BODY_POINTS + 2 * NUM_HAND_POINTS:
        return frames
    hands = np.stack([people[:, first : first + NUM_HAND_POINTS] for first in _HANDS], axis=1)
    return replace(frames, hands=lambda row: [hands[row]] if is_seen(people[row, :BODY_POINTS]) else [])


def _recorded(path: Path) -> np.ndarray:
    array = load_array(path)
    if array.ndim != 4 or array.shape[2] < BODY_POINTS or array.shape[3] not in (2, 3) or array.dtype.kind != "f":
        expected = f"(cameras, frames, {BODY_POINTS} points or more, 2)"
        what = f"The array has the shape {array.shape}, but {expected} is expected."
        raise FileDamaged(what, where=str(path))
    return array


@contextmanager
def _opened(path: Path, program: str) -> Iterator[Any]:
    """Open an HDF5 file. Errors of h5py become ``FileDamaged``, with the name of the program that wrote the file."""
    try:
        h5py = import_module("h5py")
    except ModuleNotFoundError as error:
        what = f"Reading HDF5 files from {program} needs h5py, which is not installed."
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
            what = f"The file does not have the layout of {program} ({error})."
            raise FileDamaged(what, where=str(path), hint=f"Export it from {program} again.") from error


# DeepLabCut's pandas table.
_MAGIC, _GROUP = b"\x89HDF\r\n\x1a\n", b"df_with_missing"
"""First bytes of HDF5 files, and name of DeepLabCut's table."""
_START_BYTES = 1 << 16
_LEVELS = (3, 4)
"""Possible lengths of a column name: scorer, bodyparts and coords, or with individuals after scorer."""


def is_hdf5_table(path: Path) -> bool:
    """Return whether a file is an HDF5 table from DeepLabCut, by its name or its first bytes."""
    name = path.name.lower()
    if not name.endswith((".h5", ".hdf5")):
        return False
    start = b"" if "dlc" in name else first_bytes(path, _START_BYTES)
    return "dlc" in name or (start.startswith(_MAGIC) and _GROUP in start)


def read_hdf5_table(path: Path) -> CameraFrames:
    """Read an HDF5 table from DeepLabCut."""
    with _opened(path, "DeepLabCut") as file:
        table = next(group["table"] for group in file.values() if "table" in group)
        rows = table[()]
        blocks = [name for name in rows.dtype.names if name.startswith("values_block_")]
        columns = [column for name in blocks for column in _pickled_texts(table.attrs[f"{name}_kind"])]
        values = np.concatenate([np.asarray(rows[name], np.float64).reshape(len(rows), -1) for name in blocks], axis=1)
        if {len(column) for column in columns} - set(_LEVELS) or values.shape[1] != len(columns):
            raise ValueError(f"{values.shape[1]} columns have {len(columns)} names")
        people = [column[1] if len(column) == _LEVELS[1] else "single" for column in columns]
        parts, coords = [column[-2] for column in columns], [column[-1].lower() for column in columns]
        return frames_of_columns([int(n) for n in rows["index"]], values, people, parts, coords, path)


def _pickled_texts(pickled: Any) -> list[tuple[str, ...]]:
    """Read a pickled list of string tuples. Code in the pickle is never run."""
    try:
        found = Machine(io.BytesIO(bytes(pickled)), "", frozenset()).load()
    except UnsafePickle as error:
        raise ValueError(f"its column names are not a list of strings: {error.message}") from error
    texts = isinstance(found, list) and all(isinstance(column, tuple) for column in found)
    if not texts or not all(isinstance(text, str) for column in found for text in column):
        raise ValueError("its column names are not a list of strings")
    return found


_SLEAP_NAME = re.compile(r"(labels\.v\d+\.)?(\d+_)?(?P<camera>.+?)(\.predictions)?(\.analysis)?", re.IGNORECASE)
"""Name of a SLEAP analysis file, such as ``labels.v001.000_cam01.analysis.h5`` for ``cam01``."""
_PREDICTED = 1  # ``instance_type`` of a prediction. 0 marks annotated points, which have no score.


def is_sleap(path: Path) -> bool:
    """Return whether a file has the suffix of a SLEAP analysis or project."""
    return path.name.lower().endswith((".analysis.h5", ".slp"))


def sleap_camera(path: Path) -> str:
    """Extract the video name from the name of a SLEAP file."""
    found = _SLEAP_NAME.fullmatch(path.name.rpartition(".")[0])
    return found["camera"] if found else path.stem


def read_sleap(path: Path) -> CameraFrames:
    """Read a SLEAP analysis or project with one video."""
    with _opened(path, "SLEAP") as file:
        return (_sleap_labels if path.suffix.lower() == ".slp" else _sleap_analysis)(file, path)


def _sleap_analysis(file: Any, path: Path) -> CameraFrames:
    """Read an analysis file: ``tracks`` (tracks, 2, nodes, frames) and ``point_scores`` (tracks, nodes, frames)."""
    names = file["node_names"][()].tolist()
    names = tuple(name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name) for name in names)
    tracks = np.asarray(file["tracks"][()], dtype=np.float64)
    if tracks.ndim != 4 or tracks.shape[1:3] != (2, len(names)):
        raise ValueError(f"tracks has the shape {tracks.shape}")
    seen = np.isfinite(tracks).all(axis=1)
    scores = np.asarray(file["point_scores"][()], dtype=np.float64) if "point_scores" in file else seen * 1.0
    confidence = np.where(seen & (scores > 0), np.minimum(scores, 1.0), 0.0)
    xy = np.moveaxis(tracks, (3, 0, 2, 1), (0, 1, 2, 3))
    points = np.concatenate([xy, np.moveaxis(confidence, 2, 0)[..., None]], axis=-1)
    return CameraFrames.of_array(points, path, names)


def _sleap_labels(file: Any, path: Path) -> CameraFrames:
    """Read a project file: ``frames``, ``instances``, and their ``pred_points`` (with scores) or ``points``."""
    about = json.loads(file["metadata"].attrs["json"])
    order = [node["id"] for node in about["skeletons"][0]["nodes"]]
    names = tuple(str(about["nodes"][i]["name"]) for i in order)
    table, instances = file["frames"][()], file["instances"][()]
    if len(np.unique(table["video"])) > 1:
        raise ValueError("it contains several videos, so export an analysis file for each")
    points = {True: file["pred_points"][()], False: file["points"][()]}
    frames = {}
    for row in table:
        here = range(int(row["instance_id_start"]), int(row["instance_id_end"]))
        corrected = {int(instances[i]["from_predicted"]) for i in here}
        people = [_sleap_person(instances[i], points) for i in here if i not in corrected]
        frames[int(row["frame_idx"])] = [p for p in people if len(p) == len(names) and is_seen(p)]
    return CameraFrames.in_memory(frames, path, names)


def _sleap_person(instance: np.void, points: dict[bool, np.ndarray]) -> np.ndarray:
    """Return the points (K, 3) of a SLEAP instance. Annotated points have confidence 1."""
    predicted = int(instance["instance_type"]) == _PREDICTED
    rows = points[predicted][int(instance["point_id_start"]) : int(instance["point_id_end"])]
    seen = rows["visible"] & np.isfinite(rows["x"]) & np.isfinite(rows["y"])
    score = np.minimum(rows["score"], 1.0) if predicted else np.ones(len(rows))
    return np.column_stack([rows["x"], rows["y"], np.where(seen, score, 0.0)]).astype(np.float64)
