"""Readers of what comes before a capture, of points' names, and of live points."""

from __future__ import annotations

import io
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.label_places import read_label_places
from solver_backend.body.marker_layouts import DEFAULT, load_layouts
from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.camera_calibration.boards.board import board_named
from solver_backend.camera_calibration.extrinsics.together import read_clicks
from solver_backend.camera_calibration.formats import board_toml
from solver_backend.camera_calibration.intrinsics.known_lenses import keep_lenses, known_lenses, lens_named, read_lenses
from solver_backend.cameras.noise_map import FORMAT as NOISE
from solver_backend.cameras.noise_map import read_noise_map
from solver_backend.exchange.errors import CalibrationInvalid, MocapError
from solver_backend.io.native.user_labels_file import read_user_labels
from solver_backend.labelling.outputs import MARKERS
from solver_backend.live.frames import from_lines
from solver_backend.types import JointSet
from solver_backend.videos.detect.detector import read_arrays, read_head
from solver_backend.videos.pipeline.plan import NAME as STEPS
from solver_backend.videos.pipeline.plan import Records
from solver_backend.videos.sync.clocks import Clocks, read_clocks
from solver_backend.videos.video_detections import VideoDetections, read_detections, write_detections
from tests.fuzz import odd_bodies, odd_motions, odd_values
from tests.fuzz.target import Target, Write, file, nothing
from tests.support.calibration_files import json_text, toml_text
from tests.support.scenes import ring_of_cameras, small_markers
from tests.support.trial_files import renamed

_JSON = {".json": "json"}
_CLOUD = small_markers()
_CAMERAS = ring_of_cameras(2)


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
            hands=rng.uniform(0, 400, (3, 2, 2, 21, 3)) if hands else None,
        )  # fmt: skip
        write_detections(folder / "a.npz", found)

    return write


def _read_detections(folder: Path) -> object:
    found = read_detections(folder / "a.npz", Path("a.mp4"))
    return found.fps, found.of_track(found.main_track())


def _known_lenses(folder: Path) -> object:
    return known_lenses(folder / "a.json", ("cam01", "cam02"))


def _lens_of_size(folder: Path) -> object:
    lenses = read_lenses(folder / "a.json")
    with suppress(CalibrationInvalid):
        lens_named(lenses, "cam01", (640, 480), "a.json")
    return [lens_named(lenses, "cam01", size, "a.json") for size in (None, (1280, 720), (640, 360))]


def _shown_board(text: str) -> object:
    board = board_named(text)
    return str(board), board.points, board.size_m, board.ends_differ


def _steps(folder: Path) -> object:
    records = Records(folder)
    return records.is_ours(folder / "a.npz"), records.is_made(folder / "a.npz", "anything")


def _layouts(folder: Path) -> object:
    read = load_layouts.__wrapped__(folder / "a.json")
    places = [read.place_of(label) for label in ("Anna:l_asis", "ASIS-L", "asis left", "*12")]
    return places, [read.spread_of(name) for name in read.names]


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
    except (ValueError, EOFError) as error:  # the process that sent them is named by whoever reads
        raise MocapError(str(error)) from error


def _frames(folder: Path) -> object:
    return list(from_lines(io.BytesIO((folder / "a.txt").read_bytes())))


_NOISE = {
    "format": NOISE, "version": 1, "detector": "detector 1", "confidence": [0.2, 0.5, 0.9],
    "sigma_mm": [20.0, 9.0, 4.0], "captures": ["a"], "detections": 200,
}  # fmt: skip
_LABELS = {
    "format": "manifold_mocap_labels", "version": 1,
    "places": {"LFHD": "LFHD", "x": "@left_knee", "y": "", "z": None, "C7": "c7"},
}  # fmt: skip
_TOLD = {
    "format": "manifold_mocap_user_labels", "version": 1,
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
    Target("noise of a detector", (_json(_NOISE),), lambda f: read_noise_map(f / "a.json").as_dict(), _JSON),
    Target(
        "detections",
        (_detections(False), _detections(True)),
        _read_detections,
        {".npz": "npz"},
        (odd_motions.changed(_detections(False), joint_set="BODY_25"), *odd_bodies.ARCHIVES),
    ),
    Target("answers of a detector", (_answers,), _read_answers, {".bin": "binary"}, odd_values.ANSWERS),
    Target("lenses", (_lenses,), _known_lenses, _JSON, (file("a.json", json_text(_CAMERAS, "list")),)),
    Target(
        "lenses of a calibration",
        (file("a.toml", toml_text(_CAMERAS)),),
        lambda f: known_lenses(f / "a.toml", _CAMERAS.names),
        {".toml": "text"},
        (file("a.toml", toml_text(ring_of_cameras(3))), file("a.toml", toml_text(renamed(_CAMERAS, ("x", "y"))))),
    ),
    Target("lens for pictures of a size", (_lenses,), _lens_of_size, _JSON),
    Target(
        "board",
        (file("a.toml", board_toml(board_named("charuco:5x7:35mm"))), file("a.toml", _CHARUCO)),
        lambda f: _shown_board(str(f / "a.toml")),
        {".toml": "text"},
        odd_values.BOARDS,
    ),
    Target(
        "board by a word",
        (file("a.txt", odd_values.NAMED_BOARDS[0]),),
        lambda f: _shown_board((f / "a.txt").read_bytes().decode("utf-8", "replace")[:100]),
        {".txt": "text"},
        tuple(file("a.txt", word) for word in odd_values.NAMED_BOARDS),
    ),
    Target(
        "clicks",
        (file("a.csv", _CLICKS),),
        lambda f: read_clicks(f / "a.csv"),
        {".csv": "table"},
        (file("a.csv", "a,b\n"), file("a.csv", "a,cam01,nan,1\n"), file("a.csv", '"' + "x" * 140_000)),
    ),
    Target(
        "clocks",
        (_json(_clocks()),),
        lambda f: read_clocks(f / "a.json").notes(),
        _JSON,
        odd_values.variants(
            _clocks(), ({"offset_s": [1]}, {"middle_s": None}, {"cameras": [1, 2]}, {"rate": [1e400, 0]})
        ),
    ),
    Target(
        "steps of a road",
        (file(STEPS, '{"a.npz": "ab12"}'),),
        _steps,
        _JSON,
        (file(STEPS, "["), file(STEPS, "[" * 5000), file(STEPS, "[]"), file(STEPS, b"\xff")),
        (nothing,),
    ),
    Target("places of labels", (_json(_LABELS),), lambda f: read_label_places(f / "a.json"), _JSON),
    Target(
        "told points",
        (_json(_TOLD),),
        lambda f: read_user_labels(f / "a.json", _CLOUD),
        _JSON,
        odd_values.variants(_TOLD, odd_values.TOLD_POINTS),
    ),
    Target("marker layouts", (file("a.json", DEFAULT.read_bytes()),), _layouts, _JSON, odd_values.LAYOUTS),
    Target("live points", (file("a.txt", _LINES),), _frames, {".txt": "text"}, odd_values.LINES),
)
