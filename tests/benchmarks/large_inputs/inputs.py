"""The inputs: each fills a folder and returns the arguments of the program that reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.io.native.capture_file import write_capture
from solver_backend.types import Cameras, JointSet, MarkerCloud
from tests.support.calibration_files import toml_text
from tests.support.many_views import demo_points, ring, seen_by
from tests.support.scenes import detected, walker
from tests.support.trial_files import write_detections


def _views(count: int, frames: int) -> Callable[[Path], list[str]]:
    def prepare(folder: Path) -> list[str]:
        write_capture(folder / "capture.npz", seen_by(ring(count), frames))
        return ["solve", "capture.npz", "--out", "motion.npz", "--report", "report.html"]

    return prepare


def crowd(folder: Path, count: int = 500, frames: int = 20) -> list[str]:
    """Write four cameras that each see so many people, one every 0.8 m, as OpenPose's files."""
    cameras, rng = ring(4, radius=25.0), np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(count)))
    people = []
    for i in range(count):
        place = (0.8 * (i % side - side / 2), 0.8 * (i // side - side / 2))
        points = walker(JointSet.BODY_25, frames, place, (0.2 * np.cos(i), 0.2 * np.sin(i)), phase=float(i))
        xy, confidence = detected(cameras, points, rng)
        people.append((xy, confidence * (rng.uniform(size=confidence.shape) > 0.1)))
    write_detections(folder / "pose", cameras.names, people)
    _describe(folder, cameras)
    return ["info", "."]


def many_files(folder: Path, count: int = 100_000) -> list[str]:
    """Write four cameras of one person as so many files of OpenPose."""
    cameras = ring(4)
    keypoints = seen_by(cameras, count // len(cameras)).require_multiview()[1]
    write_detections(folder / "pose", cameras.names, [(keypoints.xy, keypoints.confidence)])
    _describe(folder, cameras)
    return ["info", "."]


def _describe(folder: Path, cameras: Cameras) -> None:
    (folder / "calibration").mkdir()
    (folder / "calibration" / "Calib.toml").write_text(toml_text(cameras))
    (folder / "Config.toml").write_text("[project]\nframe_rate = 60\n")


def many_labels(folder: Path, count: int = 1000, frames: int = 600) -> list[str]:
    """Write a take of the demo's person and of so many labelled markers, most of which hang on no body."""
    points, rng = demo_points(), np.random.default_rng(0)
    at = np.arange(frames) % len(points)
    own = points.shape[1]
    cloud = np.repeat(rng.uniform([-3, -3, 0], [3, 3, 2.5], (1, count, 3)), frames, axis=0)
    cloud[:, :own] = points[at]
    labels = tuple(f"M{i:04d}" for i in range(count))
    write_c3d(folder / "take.c3d", MarkerCloud(cloud.astype(np.float32), 60.0, labels=labels))
    return ["solve", "take.c3d", "--out", "motion.npz", "--report", "report.html"]


INPUTS: dict[str, Callable[[Path], list[str]]] = {
    "200 cameras": _views(200, 60),
    "500 people": crowd,
    "1000 labels": many_labels,
    "100000 files": many_files,
    "8 views 9000 frames": _views(8, 9_000),
    "8 views 36000 frames": _views(8, 36_000),
}
"""By name."""
