"""Every reader through its public entry, with the sound files that mutations begin from."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.files.smpl_files import load_smpl_file
from solver_backend.exchange import capture_file, motion_file
from solver_backend.io.calibration import read_calibration
from solver_backend.io.footage.mp4 import read_video_header
from solver_backend.io.load import load_capture, load_motion
from solver_backend.io.markers.read import read_markers
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import read_motion, write_motion
from solver_backend.job import Job
from solver_backend.priors.weights import read_weights
from tests.body.oracle import model
from tests.support.c3d_bytes import C3dBytes
from tests.support.c3d_takes import LABELS, standing
from tests.support.calibration_files import json_text, qca_text, toml_text, yaml_camera
from tests.support.random_weights import write_random
from tests.support.scenes import ring_of_cameras, small_capture, small_markers, small_motion
from tests.support.trial_files import mp4_bytes, write_trial

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Knee
  {
    OFFSET 0 -40 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -40 5
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.02
0 90 0 1 2 3 4 5 6
0 91 0 1 2 3 4 5 7
"""


@dataclass(frozen=True)
class Target:
    """One reader."""

    name: str
    write: Callable[[Path], object]
    """Writes the sound files into an empty folder."""
    read: Callable[[Path], object]
    """Reads what lies in the folder."""
    kinds: dict[str, str]
    """Kind of mutation by the ending of a file; other files stay as they are."""
    weight: int = 1
    """How often it is tried, against the others."""


def _file(name: str, content: bytes | str) -> Callable[[Path], object]:
    data = content.encode() if isinstance(content, str) else content
    return lambda folder: (folder / name).write_bytes(data)


def _trial(folder: Path) -> None:
    write_trial(folder / "trial", frames=3, names=("cam01", "cam02", "cam03"), calibrated=("cam_1", "cam_2", "cam_3"))
    (folder / "trial" / "videos").mkdir()
    (folder / "trial" / "videos" / "cam01.mp4").write_bytes(mp4_bytes(30, 3, (1920, 1080)))


def _job(folder: Path) -> None:
    pin = {"frame": 3, "global_orient": [0.0] * 3, "body_pose": [0.1] * 69, "transl": [0.0] * 3}
    values = {
        "version": 1, "capture": "c.npz", "out": "m.npz", "report": "p.html", "overwrite": True, "fps": 30.0,
        "trim": True, "joint_set": "COCO_17", "unit": "m", "up_axis": "z",
        "settings": {"window": 20, "method": "global"},
        "resolve": {"motion": "e.npz", "first": 1, "last": 5, "pins": [pin]},
    }  # fmt: skip
    (folder / "job.json").write_text(json.dumps(values))


def _amass(folder: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {"poses": rng.normal(size=(4, 156)), "trans": rng.normal(size=(4, 3)), "betas": rng.normal(size=16)}
    np.savez(folder / "a.npz", **arrays, mocap_framerate=np.array(120.0), gender=np.array("male"))


def _pickled(folder: Path) -> None:
    plain = {name: value for name, value in model("SMPL").items() if value.dtype != object}
    (folder / "a.pkl").write_bytes(pickle.dumps(plain, protocol=2))


def _trc(folder: Path) -> None:
    lines = [
        "PathFileType\t4\t(X/Y/Z)\ta.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        "100\t100\t2\t2\tmm\t100\t1\t2",
        "Frame#\tTime\tA\t\t\tB\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
        "",
        "1\t0.0\t1\t900\t3\t4\t5\t6",
        "2\t0.01\t1\t901\t3\t4\t5\t6",
        "",
    ]
    (folder / "a.trc").write_text("\n".join(lines))


_CAMERAS = ring_of_cameras(2)
_NPZ, _TEXT, _JSON = {".npz": "npz"}, {".toml": "text", ".txt": "text", ".yml": "text"}, {".json": "json"}

TARGETS: tuple[Target, ...] = (
    Target(
        "capture file",
        lambda f: write_capture(f / "a.npz", small_capture(3)) and None,
        lambda f: load_capture(f / "a.npz"),
        _NPZ,
        2,
    ),
    Target(
        "capture file, shown",
        lambda f: write_capture(f / "a.npz", small_capture(3)) and None,
        lambda f: capture_file.read_capture(f / "a.npz"),
        _NPZ,
        6,
    ),
    Target(
        "OpenPose trial",
        _trial,
        lambda f: load_capture(f / "trial"),
        {".json": "json", ".toml": "text", ".mp4": "bytes"},
        2,
    ),
    Target(
        "calibration, TOML", _file("a.toml", toml_text(_CAMERAS)), lambda f: read_calibration(f / "a.toml"), _TEXT, 8
    ),
    Target(
        "calibration, Qualisys",
        _file("a.qca.txt", qca_text(_CAMERAS)),
        lambda f: read_calibration(f / "a.qca.txt"),
        _TEXT,
        8,
    ),
    Target(
        "calibration, OpenCV YAML",
        _file("a.yml", yaml_camera(_CAMERAS, 0, "rvec")),
        lambda f: read_calibration(f / "a.yml"),
        _TEXT,
        8,
    ),
    Target(
        "calibration, JSON",
        _file("a.json", json_text(_CAMERAS, "storage")),
        lambda f: read_calibration(f / "a.json"),
        _JSON,
        8,
    ),
    Target("BVH", _file("a.bvh", BVH), lambda f: load_motion(f / "a.bvh"), {".bvh": "text"}, 8),
    Target("AMASS", _amass, lambda f: load_motion(f / "a.npz"), _NPZ, 8),
    Target(
        "motion file",
        lambda f: write_motion(f / "a.npz", small_motion(3)) and None,
        lambda f: load_motion(f / "a.npz"),
        _NPZ,
        6,
    ),
    Target(
        "motion file, strict",
        lambda f: write_motion(f / "a.npz", small_motion(3)) and None,
        lambda f: read_motion(f / "a.npz"),
        _NPZ,
        6,
    ),
    Target(
        "motion file, shown",
        lambda f: write_motion(f / "a.npz", small_motion(3)) and None,
        lambda f: motion_file.is_motion(f / "a.npz") and motion_file.read_motion(f / "a.npz"),
        _NPZ,
        6,
    ),
    Target(
        "body .npz",
        lambda f: np.savez(f / "a.npz", **{k: v for k, v in model("SMPL").items() if k != "joint2num"}),
        lambda f: load_smpl_file(f / "a.npz"),
        _NPZ,
        4,
    ),
    Target("body .pkl", _pickled, lambda f: load_smpl_file(f / "a.pkl"), {".pkl": "bytes"}, 4),
    Target(
        "weights",
        lambda f: write_random(f / "a.npz", "svae") and None,
        lambda f: read_weights(f / "a.npz", "svae"),
        _NPZ,
        4,
    ),
    Target("job file", _job, lambda f: Job.read(f / "job.json"), _JSON, 10),
    Target(
        "video header",
        _file("a.mp4", mp4_bytes(30, 3, (1920, 1080))),
        lambda f: read_video_header(f / "a.mp4"),
        {".mp4": "bytes"},
        10,
    ),
    Target(
        "markers, C3D",
        _file("a.c3d", C3dBytes(standing(), LABELS).to_bytes()),
        lambda f: read_markers(f / "a.c3d"),
        {".c3d": "bytes"},
        4,
    ),
    Target("markers, TRC", _trc, lambda f: read_markers(f / "a.trc"), {".trc": "text"}, 4),
    Target(
        "markers, capture file",
        lambda f: write_capture(f / "a.npz", small_capture(3).__class__("m", markers=small_markers())) and None,
        lambda f: load_capture(f / "a.npz"),
        _NPZ,
        6,
    ),
)
"""The add-on's readers of captures and motions are the same code (``exchange``)."""
