"""One camera on a person rendered by Blender and detected by MediaPipe: a real detector's errors with a known truth.

A studio person performs the choreography in front of two cameras. Figures are mean distances over 12 limb joints, after
the best similarity of each frame (pa) and about the hips in the world (hip). ``drawn_pa`` and ``drawn_hip`` have the
same person and cameras with the studio's simulated detector. ``detected`` is the share of the frames in which MediaPipe
finds the person, and ``off_px`` the median distance of its points from the true points. Needs Blender's module and
``python3 dev.py detectors``.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from solver_backend.fitters.pipeline import solve
from solver_backend.io.load import load_capture
from solver_backend.io.native.motion_file import read_motion
from solver_backend.types import Capture, Keypoints2D
from solver_backend.videos.detect.detect_videos import detect_videos
from solver_backend.videos.detect.detector import DetectorChoice, DetectorMissing, chosen_detector
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.limb_errors import LIMBS, limb_errors

SPEC: dict[str, Any] = {
    "name": "one_camera", "seed": 3, "fps": 30, "frames": 90, "people": {"count": 1}, "perturb": "detector",
    "camera_arrays": [{"layout": "ring", "count": 2, "size": [640, 480], "radius_m": 3.4, "height_m": 1.4}],
    "looks": [{"name": "plain", "clothes": "random", "hair": "random", "light": "day", "furniture": 0}],
    "film": ["rgb"], "write": ["video"], "rgb": {"engine": "workbench"}, "joint_set": "MEDIAPIPE_33",
}  # fmt: skip


def run() -> list[Metric]:
    """Render, detect and solve every view alone."""
    if find_spec("bpy") is None:
        raise BenchmarkSkipped("Blender's module is not here.", hint="Install the package 'bpy'.")
    try:
        detector = chosen_detector()
    except DetectorMissing as missing:
        raise BenchmarkSkipped("MediaPipe is not here.", hint="python3 dev.py detectors") from missing
    with TemporaryDirectory() as name:
        shots = filmed(Path(name))
        rows = [row for shot in shots for row in figures_of(shot, detector)]
    mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
    units = {"detected": "%", "off_px": "px"}
    better = {"detected": "higher"}
    return [Metric(key, value, units.get(key, "mm"), better.get(key, "lower")) for key, value in mean.items()]


def filmed(folder: Path) -> list[Path]:
    """Return the folders of the shots that the studio makes."""
    spec = folder / "spec.json"
    spec.write_text(json.dumps(SPEC), encoding="utf-8")
    command = [sys.executable, "-m", "blender_addon", "dataset make", str(spec), "--out", str(folder / "set")]
    subprocess.run(command, check=True, capture_output=True)
    return sorted((folder / "set" / "shots").iterdir())


def figures_of(shot: Path, detector: DetectorChoice) -> list[dict[str, float]]:
    """Return the figures of each view of a shot."""
    clean, drawn = load_capture(shot / "clean.npz"), load_capture(shot / "perturbed.npz")
    joints = read_motion(shot / "motion.npz").joints
    cameras, true = clean.require_views()
    videos = [shot / "videos" / f"{name}.mp4" for name in cameras.names]
    rows = []
    for view, found in enumerate(detect_videos(videos, detector, shot / "detections")):
        count = min(found.num_frames, len(joints))
        keypoints = Keypoints2D(
            found.xy[None, :count, 0], found.confidence[None, :count, 0], found.joint_set, true.fps
        )  # fmt: skip
        capture = replace(clean.views([view]), keypoints=keypoints, truth={}, footage=(None,))
        off = np.linalg.norm(keypoints.xy[0] - true.xy[view, :count], axis=-1)
        pa, hip = _errors(capture, joints[:count])
        drawn_pa, drawn_hip = _errors(replace(drawn.views([view]), truth={}), joints)
        rows.append({
            "pa": pa, "hip": hip, "drawn_pa": drawn_pa, "drawn_hip": drawn_hip,
            "detected": 100.0 * float((keypoints.confidence[0] > 0).any(axis=-1).mean()),
            "off_px": float(np.nanmedian(np.where(keypoints.confidence[0] > 0, off, np.nan))),
        })  # fmt: skip
        sys.stdout.write(f"  {shot.name} {cameras.names[view]}: {pa:.0f} mm, {hip:.0f} about the hips\n")
    return rows


def _errors(capture: Capture, joints: np.ndarray) -> tuple[float, float]:
    motion = solve(capture).motion
    assert joints.shape[1] > max(LIMBS)
    return limb_errors(motion.joints, joints)
