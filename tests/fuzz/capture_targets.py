"""Readers of captures, calibrations and video headers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from solver_backend.camera_calibration.formats import colmap_texts
from solver_backend.exchange import capture_file
from solver_backend.io.calibration.read import calibrations_in, read_calibration
from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import camera_sources
from solver_backend.io.footage import read_video_header
from solver_backend.io.load import load_capture
from solver_backend.io.native.capture_file import read_capture, write_capture
from solver_backend.types import Cameras, Capture, JointSet
from tests.fuzz import odd_calibrations, odd_captures, odd_recordings
from tests.fuzz.odd_bodies import ARCHIVES, MANY_MEMBERS
from tests.fuzz.target import Target, Write, file, is_folder, large, nothing
from tests.support import other_calibrations
from tests.support.calibration_files import json_text, qca_text, toml_text, write_easymocap, yaml_camera
from tests.support.other_programs import CAMERAS, POINTS, WRITERS
from tests.support.scenes import ring_of_cameras, small_capture, small_markers
from tests.support.trial_files import mp4_bytes, write_trial

_CAMERAS = ring_of_cameras(2)
_FISHEYE = replace(_CAMERAS, distortion=_CAMERAS.distortion[:, :4] * 0.1, models=("fisheye",))
_NPZ = {".npz": "npz"}
_ODD_YAML = """%YAML:1.0
---
# what else OpenCV and people write
names: [ "a", 'b', c ]
empty:
nested: { K: [ 1.0e+03, .5, -2. ], text: "a : colon" }
list:
   - first
   - { x: 1, y: [ 2, 3 ] }
   -
      deep: 1
flag: .Nan
"""


def small_trial(joint_set: JointSet, config: str = "[project]\nframe_rate = 30\n") -> Write:
    def write(folder: Path) -> None:
        names, calibrated = ("cam01", "cam02"), ("cam_1", "cam_2")
        trial = folder / "trial"
        write_trial(trial, frames=2, names=names, calibrated=calibrated, joint_set=joint_set, config=config)
        (trial / "videos").mkdir()
        (trial / "videos" / "cam01.mp4").write_bytes(mp4_bytes(30, 2, (1920, 1080)))

    return write


def _alphapose(listed: bool) -> Write:
    """Return what writes AlphaPose's file of each camera: a list of people, or an object per picture."""

    def write(folder: Path) -> None:
        points = POINTS[:, :, :17].reshape(*POINTS.shape[:2], -1).tolist()
        for name, frames in zip(CAMERAS, points, strict=True):
            people = [{"image_id": f"{f}.jpg", "keypoints": person} for f, person in enumerate(frames)]
            pictures = {f"{f}.jpg": {"bodies": [{"joints": person}]} for f, person in enumerate(frames)}
            path = folder / "pose" / f"{name}_json" / "alphapose-results.json"
            path.parent.mkdir(parents=True)
            path.write_text(json.dumps(people if listed else pictures))

    return write


def _read_detections(folder: Path) -> None:
    """Read a folder's detections if it holds any."""
    if sources := camera_sources(folder):
        read_detections(sources, joint_set=JointSet.COCO_17)


def _small(joint_set: JointSet = JointSet.COCO_17) -> Write:
    return lambda folder: write_capture(folder / "a.npz", small_capture(2, joint_set, views=2))


def _markers(folder: Path) -> None:
    write_capture(folder / "a.npz", Capture("m", markers=small_markers()))


def _yaml(cameras: Cameras, more: str = "") -> tuple[Write, ...]:
    texts = [yaml_camera(cameras, 0, pose) + more for pose in ("rvec", "rt", "extrinsics")]
    return tuple(file("a.yml", text) for text in texts)


def _pair(folder: Path) -> None:
    (folder / "calib").mkdir()
    write_easymocap(folder / "calib", _CAMERAS)


def _colmap(folder: Path) -> None:
    for name, text in colmap_texts(_CAMERAS).items():
        (folder / name).write_text(text)


TARGETS: tuple[Target, ...] = (
    Target("capture file", (_small(),), lambda f: load_capture(f / "a.npz"), _NPZ, odd_captures.CAPTURES),
    Target(
        "capture file, strict",
        (_small(), _small(JointSet.BODY_25)),
        lambda f: read_capture(f / "a.npz"),
        _NPZ,
        (*ARCHIVES, *odd_captures.CAPTURES),
        (MANY_MEMBERS, is_folder("a.npz"), nothing, large("a.npz", 10**10)),
    ),
    Target(
        "capture file, shown",
        (_small(), _markers),
        lambda f: capture_file.read_capture(f / "a.npz").num_frames,
        _NPZ,
        odd_captures.CAPTURES,
    ),
    Target("capture file, markers", (_markers,), lambda f: load_capture(f / "a.npz"), _NPZ),
    Target(
        "capture file, one of several",
        (odd_captures.several(),),
        lambda f: load_capture(f / "a.npz", person="left"),
        _NPZ,
        (odd_captures.several(person="nobody"), odd_captures.several(people=["left", "left"]), _small()),
    ),
    Target(
        "OpenPose trial",
        (small_trial(JointSet.COCO_17), small_trial(JointSet.BODY_25B), small_trial(JointSet.HALPE_26, "")),
        lambda f: load_capture(f / "trial"),
        {".json": "json", ".toml": "text", ".mp4": "binary", ".yml": "text", ".txt": "text"},
        odd_recordings.TRIALS,
    ),
    Target(
        "OpenPose trial, told",
        (small_trial(JointSet.COCO_17),),
        lambda f: load_capture(f / "trial", fps=25.0, joint_set=JointSet.COCO_17, unit="m", up_axis="z", trim=True),
        {".json": "json", ".toml": "text"},
        odd_recordings.TRIALS,
    ),
    Target(
        "detections of other programs",
        (*WRITERS, *map(_alphapose, (True, False))),
        _read_detections,
        {".json": "json", ".jsonl": "json", ".csv": "table", ".npy": "binary", ".npz": "npz"},
    ),
    Target(
        "tracked points",
        (
            odd_recordings.table(),
            odd_recordings.table("cam_id", points=17),
        ),
        lambda f: load_capture(next(f.rglob("xy_POSE.csv"))),
        {".csv": "table", ".toml": "text"},
        (*odd_recordings.TABLES, odd_recordings.table(rate=""), odd_recordings.table(points=20)),
    ),
    Target(
        "tracked points, told",
        (odd_recordings.table(rate=""),),
        lambda f: load_capture(next(f.rglob("xy_POSE.csv")).parent, fps=50.0, up_axis="z", unit="m"),
        {".csv": "table", ".toml": "text"},
    ),
    Target(
        "calibration, told",
        (file("a.toml", toml_text(_CAMERAS, scale=1000.0)),),
        lambda f: read_calibration(f / "a.toml", unit="mm", up_axis="-y"),
        {".toml": "text"},
    ),
    Target(
        "calibration, TOML",
        (
            file("a.toml", toml_text(_CAMERAS)),
            file("a.toml", toml_text(_CAMERAS, matrices=True, nested=True)),
            file("a.toml", toml_text(_FISHEYE, scale=1000.0)),
        ),
        lambda f: read_calibration(f / "a.toml"),
        {".toml": "text"},
        (*(file("a.toml", text) for text in odd_recordings.CAMERAS), *odd_calibrations.TOML),
        (large("a.toml", 10**9), is_folder("a.toml"), nothing),
    ),
    Target(
        "calibration, Qualisys",
        (file("a.qca.txt", qca_text(_CAMERAS)), file("a.qca.txt", qca_text(_CAMERAS, left=64.0))),
        lambda f: read_calibration(f / "a.qca.txt"),
        {".txt": "text"},
        odd_calibrations.QUALISYS,
    ),
    Target(
        "calibration, OpenCV YAML",
        (*_yaml(_CAMERAS), *_yaml(_CAMERAS, _ODD_YAML.partition("---\n")[2])),
        lambda f: read_calibration(f / "a.yml"),
        {".yml": "text"},
        odd_calibrations.YAML,
    ),
    Target(
        "calibration, two YAML files",
        (_pair,),
        lambda f: read_calibration(f / "calib"),
        {".yml": "text"},
        odd_calibrations.PAIRS,
    ),
    Target(
        "calibration of other tools",
        other_calibrations.WRITERS,
        calibrations_in,
        {".json": "json", ".npz": "npz", ".txt": "table", ".csv": "table"},
    ),
    Target(
        "calibration, JSON",
        tuple(file("a.json", json_text(_CAMERAS, layout)) for layout in ("storage", "list", "dict")),
        lambda f: read_calibration(f / "a.json"),
        {".json": "json"},
        odd_calibrations.JSON,
    ),
    Target(
        "calibration, COLMAP",
        (_colmap,),
        lambda f: read_calibration(f),
        {".txt": "table"},
        odd_calibrations.COLMAP,
    ),
    Target(
        "video header",
        (
            file("a.mp4", mp4_bytes(30, 3, (1920, 1080))),
            file("a.mp4", mp4_bytes(25, 3, (640, 480), version=1, turned=True, audio_first=False)),
        ),
        lambda f: read_video_header(f / "a.mp4"),
        {".mp4": "binary"},
        tuple(file("a.mp4", content) for content in odd_recordings.VIDEOS),
        (large("a.mp4", 10**10), is_folder("a.mp4"), nothing),
    ),
)
