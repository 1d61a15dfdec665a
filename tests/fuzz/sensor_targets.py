"""Readers of recordings of sensors and of wands, and of what the add-on shows of other programs' answers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from blender_addon.body.body_file import body_path_of
from blender_addon.headless.batch.engines.cluster_task import MARKER as MARKER
from blender_addon.headless.batch.engines.cluster_task import marker_in
from blender_addon.solving.live import read_pose_line
from blender_addon.solving.take_paths import NAME as ROAD
from blender_addon.solving.take_paths import read_road
from blender_addon.studio.places import FORMAT as PLACES
from blender_addon.studio.places import read_places, shared_limits
from solver_backend.camera_calibration.formats import opencv_yaml
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import MocapError
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.png import png_bytes
from solver_backend.sensors.acquisition.acquire import SensorSightings
from solver_backend.sensors.devices.recorded import ABOUT, CALIBRATION, FRAMES, HEADER, INDEX, STUDIO_SHOT, open_folder
from solver_backend.sensors.devices.recorded import FORMAT as RECORDING
from solver_backend.sensors.fusion.moments import Gatherer
from solver_backend.sensors.wand.views import read_points_folder
from solver_backend.types import Capture
from tests.fuzz.odd_values import variants
from tests.fuzz.target import Target, Write, file, is_folder, large, nothing
from tests.support.calibration_files import toml_text
from tests.support.scenes import ring_of_cameras, small_capture, small_markers
from tests.support.trial_files import renamed

_CAMERAS = renamed(ring_of_cameras(2), ("s1", "s2"))
_ABOUT: dict[str, Any] = {
    "format": RECORDING, "version": 1, "kind": "raw", "fps": 30.0,
    "sensors": [{"name": name, "size": [4, 3], "infrared": "uint8", "depth": True} for name in _CAMERAS.names],
}  # fmt: skip
_LINES = "".join(f"{k},{k / 30},{100 + k / 30}\n" for k in range(3))


def _recording(kind: str = "raw", index: str = HEADER + _LINES, toml: str = "", **about: object) -> Write:
    """Return what writes a recording of two sensors of 4 x 3 pixels."""

    def write(folder: Path) -> None:
        (folder / ABOUT).write_text(json.dumps(_ABOUT | {"kind": kind} | about))
        (folder / CALIBRATION).write_text(toml or toml_text(_CAMERAS))
        for name in _CAMERAS.names:
            sensor = folder / name
            sensor.mkdir()
            (sensor / INDEX).write_text(index)
            (sensor / FRAMES).write_bytes(bytes(range(108)))
            for picture, dtype in (("infrared", np.uint8), ("depth", np.uint16)):
                (sensor / picture).mkdir()
                for k in range(2):
                    (sensor / picture / f"{k:06d}.png").write_bytes(png_bytes(np.full((3, 4), k, dtype)))

    return write


def _shot(folder: Path, cameras: bool = True, place: str = ".") -> None:
    """Write one shot of the studio: a capture, and pictures of what its sensors saw."""
    home = folder / place
    (home / "infrared" / "other").mkdir(parents=True)
    kept = (
        replace(small_capture(2, views=2), cameras=renamed(_CAMERAS, _CAMERAS.names))
        if cameras
        else Capture("m", markers=small_markers())
    )
    write_capture(home / STUDIO_SHOT[0], kept)
    for part in STUDIO_SHOT[1:]:
        (home / part).mkdir(parents=True, exist_ok=True)
    for name in _CAMERAS.names:
        for picture, dtype in (("infrared", np.uint8), ("depth", np.uint16)):
            (home / picture / name).mkdir(parents=True)
            (home / picture / name / "000000.png").write_bytes(png_bytes(np.full((3, 4), 9, dtype)))


def _empty_sensor(folder: Path) -> None:
    _shot(folder)
    (folder / "infrared" / "s1" / "000000.png").unlink()


def _read_recording(folder: Path) -> object:
    found = open_folder(folder)
    return [[frame.number for frame in device.frames()] for device in found.devices]


def _moments(folder: Path) -> object:
    """Gather the frames of two sensors whose times a file holds: sensor, device's and host's seconds a line."""
    text = (folder / "a.csv").read_bytes().decode("utf-8", "replace")
    try:
        rows = [(int(a), float(b), float(c)) for a, b, c in (line.split(",") for line in text.splitlines())]
    except (ValueError, OverflowError) as error:
        raise MocapError(str(error)) from error
    gatherer, found = Gatherer(("a", "b"), 1 / 30.0), 0
    empty = [np.zeros((0, *shape)) for shape in ((2,), (), (3,), (3, 3))]
    for sensor, time, host in rows:
        seen = SensorSightings(sensor % 2, time, *empty, np.zeros(3), empty[2], empty[1], host_s=host)
        gatherer.push(seen)
        found += len(gatherer.moments())
    for sensor in (0, 1):
        gatherer.ended(sensor)
    return found + len(gatherer.moments())


_TIMES = "".join(f"{k % 2},{k / 60},{9 + k / 60}\n" for k in range(12))
_SENSOR = _ABOUT["sensors"][0]
_ODD_RECORDINGS: tuple[Write, ...] = (
    _recording(format="other"), _recording(version=9), _recording("film"), _recording(fps=0), _recording(fps=1e400),
    _recording(fps=10**400), _recording(sensors=[]), _recording(sensors=[_SENSOR, _SENSOR]), _recording(sensors=5),
    *(
        _recording(sensors=[_SENSOR | change])
        for change in (
            {"size": [0, 3]}, {"size": [4]}, {"size": [1e400, 1]}, {"infrared": "int64"}, {"name": "../s1"},
            {"name": ""}, {"name": "s9"},
        )
    ),
    _recording(index=""), _recording(index="a,b,c\n"), _recording(index=HEADER), _recording(index=HEADER + "0,1\n"),
    _recording(index=HEADER + "0,0,0\n1,0.1,-9e18\n"),
    _recording(index=HEADER + "0,nan,1\n"), _recording(index=HEADER + "0,1e300,1\n1,-1e300,5\n"),
    _recording(index=HEADER + _LINES * 9), _recording("png", HEADER + _LINES * 2), _recording(toml="x = ["),
)  # fmt: skip


def _wand(depth: bool, *tables: str, lens: str = "yaml") -> Write:
    """Return what writes the tables of sensors that saw a wand."""
    rows = [f"{k}000000;{100 + k};{200 + k}" for k in range(4)]
    text = "t_ns;u;v;depth_mm\n" + "".join(f"{row};{1500}\n" for row in rows) if depth else ""
    text = text or "".join(f"{row};{300};{310};-1;-1\n" for row in rows)

    def write(folder: Path) -> None:
        for c, name in enumerate(_CAMERAS.names):
            (folder / f"{name}.csv").write_text(tables[c] if c < len(tables) else text)
            if lens == "yaml":
                (folder / f"{name}.yaml").write_text(opencv_yaml(_CAMERAS.subset([c])))
            elif lens == "toml":
                (folder / f"{name}.toml").write_text(toml_text(_CAMERAS.subset([c])))

    return write


_ODD_WANDS: tuple[Write, ...] = (
    _wand(True, "t_ns;u;v\n1;2;3\n"), _wand(True, ""), _wand(True, "t_ns;u;v;depth_mm\n"), _wand(True, "1;2;3\n"),
    _wand(True, "1;2;3;4;5;6;x\n"), _wand(True, "1;2;3;4;5;6;7\n2;2;3;4;5;6;7\n"), _wand(False, lens=""),
    _wand(False, "9;1;2;3;4;5;6\n1;1;2;3;4;5;6\n"), _wand(False, "nan;1;2;3;4;5;6\n"), _wand(False, "1;2;3\n1;2\n"),
    _wand(True, "t_ns;u;v;depth_mm\n1;1;1;5\n1;2;2;6\n2;1;1;nan\n"),
)  # fmt: skip
_ROAD: dict[str, Any] = {
    "format": "manifold_mocap_road", "version": 2,
    "steps": [{"step": "sync", "state": "made", "diagnostics": [diagnostic("rolling_shutter").as_dict()],
               "pictures": ["a.png", "../b.png"]}],
}  # fmt: skip
_MAPS: dict[str, Any] = {
    "format": PLACES, "version": 1,
    "places": [{"camera_array": "a", "x_m": [0, 1], "y_m": [0, 1, 2], "error_mm": [[1, 2], [3, None], [5, 6]]}],
}  # fmt: skip
_POSE = {
    "state": "solved", "why": "", "off_mm": 2.5, "cloud": [1, 2, 3], "root": [0, 0, 0], "trans": [0, 0, 1],
    "pose": [0.1] * 63,
}  # fmt: skip


def _places(folder: Path) -> object:
    maps = read_places(folder / "a.json")
    return shared_limits(maps), [item.median_mm for item in maps]


def _poses(folder: Path) -> object:
    return [read_pose_line(line) for line in (folder / "a.txt").read_bytes().decode("utf-8", "replace").split("\n")]


TARGETS: tuple[Target, ...] = (
    Target(
        "moments of sensors",
        (file("a.csv", _TIMES),),
        _moments,
        {".csv": "table"},
        (
            file("a.csv", _TIMES + "0,0.2,-9e18\n1,0.2,9e18\n" + _TIMES),
            file("a.csv", "0,nan,inf\n1,-inf,0\n0,1e300,1\n"),
        ),
    ),
    Target(
        "recording of sensors",
        (_recording(), _recording("png", HEADER + "0,0,1\n1,0.1,1.1\n")),
        _read_recording,
        {".json": "json", ".csv": "table", ".toml": "text", ".bin": "binary", ".png": "png"},
        _ODD_RECORDINGS,
        (nothing, lambda folder: (_recording()(folder), (folder / CALIBRATION).unlink())),
    ),
    Target(
        "sensors of a shot",
        (_shot, lambda folder: _shot(folder, place="shots/a")),
        _read_recording,
        {".npz": "npz", ".png": "png"},
        (_empty_sensor, lambda folder: _shot(folder, cameras=False)),
        (lambda folder: (_shot(folder, place="shots/a"), _shot(folder, place="shots/b")),),
    ),
    Target(
        "tables of a wand",
        (_wand(True), _wand(False), _wand(True, lens="toml")),
        read_points_folder,
        {".csv": "table", ".yaml": "text", ".toml": "text"},
        _ODD_WANDS,
        (nothing,),
    ),
    Target(
        "steps of a road, shown",
        (file(ROAD, json.dumps(_ROAD)),),
        read_road,
        {".json": "json"},
        variants(_ROAD, ({"version": 3}, {"steps": 5}, {"steps": [{"words": 5, "pictures": [1, "/x.png"]}]},
                          {"version": 1, "steps": [{"step": "sync", "words": ["a"], "doubts": ["b", 1]}]}), ROAD),
        (nothing, large(ROAD, 10**8)),
    ),
    Target(
        "errors by place",
        (file("a.json", json.dumps(_MAPS)),),
        _places,
        {".json": "json"},
        variants(
            _MAPS,
            (
                {"version": 3}, {"places": 5}, {"places": []}, {"places": [{"rig": "a"}]},
                {"places": [{"rig": "a", "x_m": 5, "y_m": 1, "error_mm": 1}]},
                {"places": [{"rig": "a", "x_m": [10**400], "y_m": [1], "error_mm": [[1]]}]},
            ),
        ),
        (nothing, is_folder("a.json")),
    ),
    Target("poses of a live run", (file("a.txt", json.dumps(_POSE) + "\n"),), _poses, {".txt": "text"}, (
        *(file("a.txt", json.dumps(_POSE | change)) for change in (
            {"state": 1}, {"cloud": [1]}, {"root": None}, {"pose": [1]}, {"off_mm": "x"}, {"off_mm": 10**400},
            {"trans": [1e9, 0, 0]},
        )),
        file("a.txt", "["), file("a.txt", "[" * 5000), file("a.txt", "[]"),
    )),
    Target(
        "body of a motion",
        (file("a.json", '{"settings": {"body": "neutral"}}'),),
        lambda f: body_path_of((f / "a.json").read_bytes().decode("utf-8", "replace")),
        {".json": "json"},
        tuple(
            file("a.json", text)
            for text in ("[" * 5000, "{}", "[]", *(json.dumps({"settings": {"body": name}}) for name in (
                "none", "~nobody/b.npz", "a\0b.npz", "x" * 5000 + ".npz", 5, "/dev/null"
            )))
        ),
    ),
    Target("marker of a batch", (file(MARKER, "ab12"),), marker_in, {"": "text"}, (), (nothing, is_folder(MARKER))),
)  # fmt: skip
