"""Readers of what comes before a capture, of points' names, and of live points."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.label_places import read_label_places
from solver_backend.body.marker_layouts import DEFAULT, load_layouts
from solver_backend.exchange.errors import MocapError
from solver_backend.io.native.told_file import read_told
from solver_backend.labelling.outputs import MARKERS
from solver_backend.live.frames import from_lines
from solver_backend.rig.adjustment.lens import Lens
from solver_backend.rig.boards.board import board_named, board_toml
from solver_backend.rig.detect.answers import read_arrays, read_head
from solver_backend.rig.detect.noise_map import FORMAT as NOISE
from solver_backend.rig.detect.noise_map import read_noise_map
from solver_backend.rig.detect.video_detections import VideoDetections, read_detections, write_detections
from solver_backend.rig.extrinsics.points_session import read_clicks
from solver_backend.rig.intrinsics.known_lenses import known_lenses
from solver_backend.rig.intrinsics.library import keep_lenses
from solver_backend.rig.road.records import NAME as STEPS
from solver_backend.rig.road.records import Records
from solver_backend.rig.sync.clocks import Clocks, read_clocks
from solver_backend.types import JointSet
from tests.fuzz.target import Target, Write, file
from tests.support.scenes import small_markers

_JSON = {".json": "json"}
_CLOUD = small_markers()


def _json(values: Any) -> Write:
    return file("a.json", json.dumps(values))


def _lenses(folder: Path) -> None:
    K = np.array([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]])
    lenses = {name: Lens(K, np.zeros(8), (1280, 720), "opencv") for name in ("cam01", "cam02")}
    keep_lenses(folder / "a.json", lenses, {"cam01": 0.21})


def _detections(hands: bool) -> Write:
    def write(folder: Path) -> None:
        rng = np.random.default_rng(4)
        times = np.arange(3) / 30.0
        found = VideoDetections(
            Path("a.mp4"), "ab12", "detector 1", JointSet.COCO_17, (640, 480), times,
            rng.uniform(0, 400, (3, 2, 17, 2)), rng.uniform(0, 1, (3, 2, 17)), np.array([[0, 1], [0, -1], [1, 0]]),
            rng.uniform(0, 400, (3, 2, 2, 21, 3)) if hands else None,
        )  # fmt: skip
        write_detections(folder / "a.npz", found)

    return write


def _read_detections(folder: Path) -> object:
    found = read_detections(folder / "a.npz", Path("a.mp4"))
    return found.fps, found.of_track(found.main_track())


def _clocks() -> dict[str, Any]:
    covariance = np.tile(np.diag([1e-6, 1e-12]), (2, 1, 1))
    return Clocks(("a", "b"), np.array([0.0, 0.02]), np.array([0.0, 1e-5]), covariance, 1.5, "speeds").as_dict()


def _answers(folder: Path) -> None:
    head = json.dumps({"arrays": {"xy": [1, 2, 2], "confidence": [1, 2]}}).encode()
    (folder / "a.bin").write_bytes(head + b"\n" + np.arange(6, dtype=np.float32).tobytes())


def _read_answers(folder: Path) -> object:
    stream = io.BytesIO((folder / "a.bin").read_bytes())
    try:
        return read_arrays(read_head(stream), stream)
    except ValueError as error:  # the process that sent them is named by whoever reads
        raise MocapError(str(error)) from error


def _frames(folder: Path) -> object:
    text = (folder / "a.txt").read_bytes().decode("utf-8", "replace")
    return list(from_lines(io.StringIO(text)))


_NOISE = {
    "format": NOISE, "detector": "detector 1", "confidence": [0.2, 0.5, 0.9], "sigma_mm": [20.0, 9.0, 4.0],
    "captures": ["a"], "detections": 200,
}  # fmt: skip
_LABELS = {
    "format": "manifold_mocap_labels", "version": 1,
    "places": {"LFHD": "LFHD", "x": "@left_knee", "y": "", "z": None, "C7": "c7"},
}  # fmt: skip
_TOLD = {
    "format": "manifold_mocap_told_points", "version": 1,
    "points": [{"point": 0, "frame": 1, "marker": MARKERS[0]}, {"point": 0, "frame": 0, "marker": ""}],
}  # fmt: skip
_CHARUCO = """[charuco]
columns = 4
rows = 5
square_size_override_cm = 5.4
aruco_scale = 0.75
dictionary = "DICT_4X4_50"
inverted = false
"""
_CLICKS = "point,camera,x,y\ncorner,cam01,320.5,200\ncorner,cam02,310,190.25\ncorner,world,0,0.5,1\n# a word\n\n"
_LINES = '{"t": 0.1, "points": [[0.1, 0.2, 1.0], [0, 0, 1.5]]}\n0.2 1 2 3 4 5 6\n0.3,1,2,3\n\n{"points": []}\n'

TARGETS: tuple[Target, ...] = (
    Target("noise of a detector", (_json(_NOISE),), lambda f: read_noise_map(f / "a.json").as_dict(), _JSON, 20),
    Target("detections", (_detections(False), _detections(True)), _read_detections, {".npz": "npz"}, 12),
    Target("answers of a detector", (_answers,), _read_answers, {".bin": "binary"}, 20),
    Target("lenses", (_lenses,), lambda f: known_lenses(f / "a.json", ("cam01", "cam02")), _JSON, 20),
    Target(
        "board",
        (file("a.toml", board_toml(board_named("charuco:5x7:35mm"))), file("a.toml", _CHARUCO)),
        lambda f: str(board_named(str(f / "a.toml"))),
        {".toml": "text"},
        20,
    ),
    Target("clicks", (file("a.csv", _CLICKS),), lambda f: read_clicks(f / "a.csv"), {".csv": "text"}, 20),
    Target("clocks", (_json(_clocks()),), lambda f: read_clocks(f / "a.json").lines(), _JSON, 20),
    Target(
        "steps of a road", (file(STEPS, '{"a.npz": "ab12"}'),), lambda f: Records(f).is_ours(f / "a.npz"), _JSON, 10
    ),
    Target("places of labels", (_json(_LABELS),), lambda f: read_label_places(f / "a.json"), _JSON, 20),
    Target("told points", (_json(_TOLD),), lambda f: read_told(f / "a.json", _CLOUD), _JSON, 20),
    Target(
        "marker layouts",
        (file("a.json", DEFAULT.read_bytes()),),
        lambda f: load_layouts.__wrapped__(f / "a.json").place_of("Anna:l_asis"),
        _JSON,
        6,
    ),
    Target("live points", (file("a.txt", _LINES),), _frames, {".txt": "text"}, 20),
)
