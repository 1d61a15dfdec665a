"""SLEAP's two HDF5 files: ``.analysis.h5`` (tracks by frame) and ``.slp`` (labels and predictions)."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.detections.camera_frames import CameraFrames, People
from solver_backend.io.detections.hdf5 import opened

_NAME = re.compile(r"(labels\.v\d+\.)?(\d+_)?(?P<camera>.+?)(\.predictions)?(\.analysis)?", re.IGNORECASE)
"""``labels.v001.000_cam01.analysis.h5`` is of ``cam01``."""
_PREDICTED = 1
"""``instance_type`` of a prediction; 0 is of a person who clicked it, whose points have no score."""


def is_sleap(path: Path) -> bool:
    """Whether a file's name is one that SLEAP gives."""
    return path.name.lower().endswith((".analysis.h5", ".slp"))


def camera_name(path: Path) -> str:
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
