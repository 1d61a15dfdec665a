"""Read detections: CPU seconds of ``info`` on 36,000 OpenPose files of four cameras, and frames per second of tables.

The demo's detections are played forwards and backwards. ``openpose_s`` includes all steps of ``info``: reading,
agreement of the views, and choice of the person. Tables of 4 cameras and 5000 frames each are read to arrays, and
frames of all cameras count.
"""

from __future__ import annotations

import csv
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.load import load_capture
from tests.benchmarks.metric import Metric
from tests.benchmarks.strangers.take import COCO, LENGTH, demo_take, write_rate, write_toml

Rows = Sequence[Sequence[object]]
FILES, ROWS = 9000, 5000
"""Number of files and of table rows for each of the four cameras."""
_NAMED = [(name, coord) for name in COCO for coord in ("x", "y", "likelihood")]


def run() -> list[Metric]:
    """Write and read every kind."""
    with tempfile.TemporaryDirectory() as folder:
        metrics = [Metric("openpose_s", _openpose(Path(folder) / "openpose"), "s", rel_tol=1.0)]
        for name, write in TABLES.items():
            rate = _table(Path(folder) / name, write)
            metrics.append(Metric(f"{name}_frames_a_second", rate, "1/s", "higher", rel_tol=0.5))
    return metrics


def _to_and_fro(count: int) -> np.ndarray:
    """Return rows of the demo in forward and backward order."""
    phase = np.arange(count) % (2 * LENGTH)
    return np.where(phase < LENGTH, phase, 2 * LENGTH - 1 - phase)


def _openpose(root: Path) -> float:
    take = demo_take(0, LENGTH)
    lists = {"face_keypoints_2d": [], "hand_left_keypoints_2d": [], "hand_right_keypoints_2d": []}
    for name, points in zip(take.names, take.points, strict=True):
        people = [{"person_id": [-1], "pose_keypoints_2d": frame.ravel().tolist(), **lists} for frame in points]
        texts = [json.dumps({"version": 1.3, "people": [person]}) for person in people]
        place = root / "pose" / f"{name}_json"
        place.mkdir(parents=True)
        for f, row in enumerate(_to_and_fro(FILES)):
            (place / f"{name}_{f:012d}_keypoints.json").write_text(texts[row])
    write_toml(root, take.cameras)
    write_rate(root)
    started = time.process_time()
    load_capture(root)
    return time.process_time() - started


def _table(root: Path, write: Callable[[str, np.ndarray], tuple[str, Rows]]) -> float:
    take, root_rows = demo_take(0, LENGTH), _to_and_fro(ROWS)
    root.mkdir(parents=True)
    for name, points in zip(take.names, take.coco(), strict=True):
        file, rows = write(name, points[root_rows].reshape(ROWS, -1).round(3))
        with (root / file).open("w", newline="") as opened:
            csv.writer(opened).writerows(rows)
    started = time.process_time()
    found = read_detections(camera_sources(root))
    return len(found.cameras) * found.num_frames / (time.process_time() - started)


def _deeplabcut(name: str, values: np.ndarray, *individuals: Sequence[object]) -> tuple[str, Rows]:
    headings = [["scorer", *["DLC"] * len(_NAMED)], *individuals, ["bodyparts", *(part for part, _ in _NAMED)]]
    rows = [[f, *row] for f, row in enumerate(values.tolist())]
    return f"{name}DLC_resnet50.csv", [*headings, ["coords", *(coord for _, coord in _NAMED)], *rows]


def _deeplabcut_animals(name: str, values: np.ndarray) -> tuple[str, Rows]:
    return _deeplabcut(name, values, ["individuals", *["ind1"] * len(_NAMED)])


def _sleap(name: str, values: np.ndarray) -> tuple[str, Rows]:
    heading = ["track", "frame_idx", "instance.score", *(f"{n}.{x}" for n in COCO for x in ("x", "y", "score"))]
    rows = [["track_0", f, 0.9, *row] for f, row in enumerate(values.tolist())]
    return f"labels.v001.000_{name}.analysis.csv", [heading, *rows]


def _own(name: str, values: np.ndarray) -> tuple[str, Rows]:
    heading = ["frame", *(f"{part}_{coord}" for part, coord in _NAMED)]
    return f"{name}.csv", [heading, *([f, *row] for f, row in enumerate(values.tolist()))]


def _points(name: str, values: np.ndarray) -> tuple[str, Rows]:
    points = values.reshape(ROWS, len(COCO), 3).tolist()
    rows = [[f, part, *point] for f, frame in enumerate(points) for part, point in zip(COCO, frame, strict=True)]
    return f"{name}.csv", [["frame", "keypoint", "x", "y", "score"], *rows]


TABLES = {"deeplabcut": _deeplabcut, "deeplabcut_animals": _deeplabcut_animals, "sleap": _sleap, "own": _own,
          "point_rows": _points}  # fmt: skip
"""File name and rows of one camera, by table kind."""
