"""Inputs for every verb of the solver's command line, and what is typed to run each of them on these."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.camera_calibration.formats import write_calibration
from solver_backend.io.markers.read import write_markers
from solver_backend.io.native.capture_file import write_capture
from solver_backend.io.native.motion_file import write_motion
from solver_backend.synthesis.embedded.demo import demo_capture, record_markers
from solver_backend.synthesis.studio.data_set import make_data_set
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.types import Cameras
from tests.support.bvh_texts import known_motion, write_bvh
from tests.support.calibration_files import toml_text
from tests.support.drawn_gloves import drawn_gloves, hands_bvh
from tests.support.pose_models import write_rtmpose
from tests.support.recorded_markers import recorded
from tests.support.recordings import recordings_folder
from tests.support.short_motion import short_motion
from tests.support.trial_files import write_detections
from tests.support.videos import write_dots
from tests.support.waved_wand import as_tables, sensors, waved

FRAMES = 120
FOOTAGE_SIZE = 160, 120
"""Pixels of the videos."""
PLAYED_OAK = Path(__file__).with_name("played_oak")
"""A folder for PYTHONPATH, in which ``depthai`` plays cameras that nobody has."""
_STUDIO = {
    "camera_arrays": [{"preset": "azure_kinect_3", "scale": 0.3}], "frames": 40, "fps": 20, "film": ["masks"],
    "write": ["pose2sim"], "perturb": "detector", "seed": 9,
}  # fmt: skip


def write_inputs(folder: Path) -> None:
    """Fill a folder with everything that the commands read."""
    demo = demo_capture(FRAMES, 60.0)
    cameras, keypoints = demo.require_multiview()
    write_capture(folder / "capture.npz", demo)
    write_detections(folder / "trial" / "pose", cameras.names, [(keypoints.xy, keypoints.confidence)])
    (folder / "trial" / "calibration").mkdir()
    (folder / "trial" / "calibration" / "Calib.toml").write_text(toml_text(cameras))
    (folder / "trial" / "Config.toml").write_text("[project]\nframe_rate = 60\n")
    (folder / "rig.toml").write_text(toml_text(_filmed_small(cameras.subset([0, 1]))))
    write_motion(folder / "motion.npz", short_motion(FRAMES))
    worn = record_markers().cloud
    write_markers(folder / "take.c3d", worn)
    write_markers(folder / "unlabelled.c3d", replace(worn, labels=None))
    marked = replace(
        short_motion(FRAMES), markers=np.zeros((FRAMES, 2, 3), np.float32), marker_labels=("A", "B"),
        marker_residual_mm=np.zeros((FRAMES, 2), np.float32),
    )  # fmt: skip
    write_motion(folder / "marked.npz", marked)
    write_bvh(folder / "clip.bvh", known_motion(load_body(), np.zeros(10)))
    hands_bvh(folder / "gloves.bvh", drawn_gloves(), 0, "LeftHand{finger}{number}")
    if recordings_folder().is_dir():
        (folder / "data").symlink_to(recordings_folder())
    _write_footage(folder, cameras.names)
    _write_sensors(folder)
    (folder / "spec.json").write_text(json.dumps(_STUDIO))
    made = _STUDIO | {"frames": 5}
    make_data_set(spec_of(made), folder / "set")
    (folder / "floor.json").write_text(json.dumps({"camera_arrays": ["oak_d_4"], "perturb": "detector"}))


def _filmed_small(cameras: Cameras) -> Cameras:
    """Return the cameras as they are for the pictures of ``_write_footage``."""
    K = cameras.K.copy()
    K[:, :2] *= (np.array(FOOTAGE_SIZE) / cameras.image_size)[:, :, None]
    return replace(cameras, K=K, image_size=np.tile(FOOTAGE_SIZE, (len(cameras), 1)))


def _write_footage(folder: Path, names: tuple[str, ...]) -> None:
    """Write two videos of three moving dots, and a detector that finds them."""
    write_rtmpose(folder / "model.onnx")
    (folder / "footage" / "videos").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name in names[:2]:
        dots = np.array([[30.0, 25.0], [120.0, 40.0], [80.0, 95.0]])
        path = dots + np.cumsum(rng.normal(0, 0.3, (FRAMES, 3, 2)), axis=0)
        write_dots(folder / "footage" / "videos" / f"{name}.mp4", path, np.arange(FRAMES) / 30.0, FOOTAGE_SIZE)


def _write_sensors(folder: Path) -> None:
    recorded(folder / "recording")
    (folder / "wand").mkdir()
    write_calibration(folder / "lenses.toml", sensors())
    for name, text in as_tables(waved(sensors())).items():
        (folder / "wand" / name).write_text(text)


COMMANDS: dict[str, tuple[str, ...]] = {
    "info": ("info", "trial"),
    "convert": ("convert", "trial", "--out", "out.npz"),
    "dataset demo": ("dataset demo", "--out", "out.npz"),
    "solve": ("solve", "capture.npz", "--out", "out.npz", "--report", "out.html"),
    "from-videos": ("from-videos", "footage", "--detector", "model.onnx", "--sync", "none", "--until", "sync"),
    "evaluate": ("evaluate", "capture.npz", "motion.npz"),
    "explain": ("explain",),
    "motion bodies": ("motion bodies",),
    "motion trim": ("motion trim", "motion.npz", "out.npz", "--frames", "10", "40"),
    "motion loop": ("motion loop", "motion.npz", "out.npz"),
    "motion mirror": ("motion mirror", "motion.npz", "out.npz"),
    "motion join": ("motion join", "motion.npz", "motion.npz", "out.npz"),
    "motion retime": ("motion retime", "motion.npz", "out.npz", "--speed", "1.2"),
    "motion resample": ("motion resample", "motion.npz", "out.npz", "--fps", "30"),
    "motion in-place": ("motion in-place", "motion.npz", "out.npz"),
    "motion root-motion": ("motion root-motion", "motion.npz", "out.npz"),
    "cameras detect": (
        "cameras detect", "footage/videos", "--detector", "model.onnx", "--sync", "none", "--out", "out.npz",
    ),
    "cameras noise": ("cameras noise", "capture.npz", "--out", "out.json"),
    "hands find": ("hands find", "capture.npz", "--model", "model.onnx", "--python", "python", "--out", "out.npz"),
    "markers label": ("markers label", "unlabelled.c3d", "--out", "out.c3d"),
    "markers calibrate": ("markers calibrate", "take.c3d", "--out", "out.npz"),
    "markers layout": ("markers layout", "take.c3d", "--out", "out.json"),
    "markers places": ("markers places", "--out", "out.png"),
    "markers export": ("markers export", "marked.npz", "--out", "out.c3d"),
    "motion props": ("motion props", "motion.npz", "--out", "out.json"),
    "motion export": ("motion export", "motion.npz", "--out", "out"),
    "cameras check": ("cameras check", "trial"),
    "cameras fit": ("cameras fit", "trial", "--stature", "1.78", "--out", "out.toml"),
    "cameras refine": ("cameras refine", "trial", "--out", "out.npz"),
    "cameras calibrate": (
        "cameras calibrate", "capture.npz", "--from", "person", "--stature", "1.74", "--out", "out.toml",
    ),
    "cameras board": ("cameras board", "charuco:5x7:35mm", "--out", "out.pdf"),
    "sensors list": ("sensors list",),
    "sensors record": ("sensors record", "out", "--oak", "1=left", "--oak", "2=right", "--seconds", "600"),
    "sensors colour": ("sensors colour", "out", "--oak", "1=left", "--oak", "2=right", "--seconds", "600"),
    "sensors calibrate": ("sensors calibrate", "wand", "--lenses", "lenses.toml", "--out", "out.toml"),
    "sensors markers": ("sensors markers", "recording", "--out", "out.c3d"),
    "sensors copy": ("sensors copy", "recording", "--out", "out"),
    "sensors live": ("sensors live", "recording", "--repeat", "--poses", "--lines", "out.jsonl"),
    "live stream": ("live stream", "take.c3d", "--repeat", "--lines", "out.jsonl", "--record", "out.c3d"),
    "live cameras": (
        "live cameras", "footage/videos/cam01.mp4", "footage/videos/cam02.mp4", "--calibration", "rig.toml",
        "--detector", "model.onnx", "--repeat", "--lines", "out.jsonl", "--record", "out.npz",
    ),
    "motion convert": ("motion convert", "clip.bvh", "--out", "out.npz"),
    "hands add": ("hands add", "motion.npz", "gloves.bvh", "--offset", "0", "--out", "out.npz"),
    "motion denoise": ("motion denoise", "motion.npz", "out.npz"),
    "motion complete": ("motion complete", "motion.npz", "out.npz", "--missing", "left_arm"),
    "motion interpolate": ("motion interpolate", "motion.npz", "out.npz", "--frames", "10", "40", "--count", "30"),
    "motion fit": ("motion fit", "capture.npz", "motion.npz", "out.npz"),
    "motion sample": ("motion sample", "out.npz", "--count", "100"),
    "dataset make": ("dataset make", "spec.json", "--out", "out"),
    "dataset benchmark": ("dataset benchmark", "set"),
    "dataset cameras": ("dataset cameras", "floor.json", "--out", "out.html"),
    "train model": ("train model", "rvposer", "--data", "data", "--out", "out"),
    "train export": ("train export", "--out", "out.onnx"),
}  # fmt: skip
"""What is typed for each verb, in the folder of ``write_inputs``."""
