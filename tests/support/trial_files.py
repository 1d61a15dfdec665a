"""Recordings on disk as other tools leave them, for the tests of reading them."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.detections.read import read_detections
from solver_backend.io.detections.search import of_folder
from solver_backend.types import Cameras, Detections, JointSet
from tests.support.calibration_files import toml_text
from tests.support.scenes import detected, ring_of_cameras, walker

Person = tuple[np.ndarray, np.ndarray]  # xy (C, F, K, 2) and confidence (C, F, K).


def frame_text(people: Sequence[np.ndarray]) -> str:
    """Return OpenPose's JSON of people (K, 3) in one frame; NaN becomes 0 0 0."""
    entries = [{"person_id": [-1], "pose_keypoints_2d": _flat(person), "face_keypoints_2d": []} for person in people]
    return json.dumps({"version": 1.3, "people": entries})


def _flat(person: np.ndarray) -> list[float]:
    unseen = ~np.isfinite(person).all(-1) | (person[:, 2] == 0)
    return [round(float(v), 3) for v in np.where(unseen[:, None], 0.0, person).ravel()]


def read_folders(folders: Mapping[str, Path], **options: Any) -> Detections:
    """Read the folders of cameras by the cameras' names; options as of ``read_detections``."""
    return read_detections({name: of_folder(folder) for name, folder in folders.items()}, **options)


def write_detections(
    parent: Path, names: Sequence[str], people: Sequence[Person], *, frames: Sequence[int] | None = None
) -> None:
    """Write ``<name>_json/<name>_000000000000_keypoints.json`` for every camera and frame, people in the given order.

    Args:
        parent: folder of the cameras' folders.
        names: one a camera.
        people: detections of each person; confidence 0 everywhere = not in that view's file.
        frames: how many frames each camera has; None = all.
    """
    for c, name in enumerate(names):
        folder = parent / f"{name}_json"
        folder.mkdir(parents=True)
        for f in range(people[0][0].shape[1] if frames is None else frames[c]):
            here = [np.concatenate([xy[c, f], conf[c, f][:, None]], axis=1) for xy, conf in people if conf[c, f].any()]
            (folder / f"{name}_{f:012d}_keypoints.json").write_text(frame_text(here))


def write_trial(
    root: Path,
    *,
    cameras: Cameras | None = None,
    people: Sequence[Person] | None = None,
    joint_set: JointSet = JointSet.COCO_17,
    frames: int = 20,
    lengths: Sequence[int] | None = None,
    names: Sequence[str] = ("cam01", "cam02", "cam03", "cam04"),
    calibrated: Sequence[str] | None = ("cam_1", "cam_2", "cam_3", "cam_4"),
    config: str = "[project]\nframe_rate = 30\n",
) -> Cameras:
    """Write a trial of a walking person as Pose2Sim keeps it, and return its cameras.

    Args:
        root: the trial's folder.
        cameras: by default four around the person.
        people: detections; by default one noisy walker.
        joint_set: of the default walker.
        frames: of the default walker.
        lengths: number of frames of each camera.
        names: of the folders.
        calibrated: names in the calibration; None writes no calibration.
        config: text of Config.toml; empty writes none.
    """
    cameras = ring_of_cameras(len(names)) if cameras is None else cameras
    if people is None:
        points = walker(joint_set, frames, (-0.5, 0.0), (0.4, 0.1))
        people = [detected(cameras, points, np.random.default_rng(0))]
    write_detections(root / "pose", names, people, frames=lengths)
    if calibrated is not None:
        (root / "calibration").mkdir(parents=True)
        (root / "calibration" / "Calib.toml").write_text(toml_text(renamed(cameras, calibrated)))
    if config:
        (root / "Config.toml").write_text(config)
    return cameras


def renamed(cameras: Cameras, names: Sequence[str]) -> Cameras:
    """Return the cameras under other names."""
    fields: dict[str, Any] = {k: getattr(cameras, k) for k in ("K", "distortion", "R", "t", "image_size")}
    return Cameras(names=tuple(names), **fields)


def _box(kind: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I4s", 8 + len(data), kind) + data


def mp4_bytes(
    fps: float, frames: int, size: tuple[int, int], *, version: int = 0, turned: bool = False, audio_first: bool = True,
    stored: tuple[int, int] | None = None,
) -> bytes:  # fmt: skip
    """Return an MP4 that is all header: enough to tell frame rate, length, and the shown and the stored size."""
    timescale, ticks = 90000, round(90000 / fps)
    wide = ">QQI" if version else ">III"
    one, width, height = 1 << 16, size[0] << 16, size[1] << 16
    matrix = (0, one, 0, -one, 0) if turned else (one, 0, 0, 0, one)
    head = struct.pack(">I", version << 24)
    tkhd = head + b"\0" * ((32 if version else 20) + 16)
    tkhd += struct.pack(">9i", matrix[0], matrix[1], 0, matrix[3], matrix[4], 0, 0, 0, 1 << 30)
    tkhd += struct.pack(">II", width, height)
    mdhd = head + struct.pack(wide, 0, 0, timescale) + b"\0" * 8
    stts = struct.pack(">II", 0, 1) + struct.pack(">II", frames, ticks)
    entry = b"" if stored is None else _box(b"avc1", b"\0" * 24 + struct.pack(">HH", *stored) + b"\0" * 50)
    stsd = b"" if stored is None else _box(b"stsd", struct.pack(">II", 0, 1) + entry)

    def track(handler: bytes) -> bytes:
        media = _box(
            b"mdia", _box(b"mdhd", mdhd), _box(b"hdlr", b"\0" * 8 + handler + b"\0" * 12),
            _box(b"minf", _box(b"stbl", stsd, _box(b"stts", stts))),
        )  # fmt: skip
        return _box(b"trak", _box(b"tkhd", tkhd), media)

    tracks = ([track(b"soun")] if audio_first else []) + [track(b"vide")]
    return _box(b"ftyp", b"isom") + _box(b"mdat", b"\0" * 100) + _box(b"moov", _box(b"mvhd", b"\0" * 100), *tracks)
