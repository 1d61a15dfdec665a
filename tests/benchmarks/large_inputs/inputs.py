"""The inputs: each fills a folder and returns the module of the program that reads it, and its arguments."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, JointSet, MarkerCloud
from tests.support.calibration_files import toml_text
from tests.support.many_views import demo_points, ring, seen_by
from tests.support.scenes import detected, walker
from tests.support.short_solves import cut
from tests.support.trial_files import write_detections

SOLVER, ADDON = "solver_backend", "blender_addon"
_QUICK = {"iterations": 1, "residual_rotations": False, "contacts": False, "learn_noise": False}


def _views(count: int, frames: int) -> Callable[[Path], list[str]]:
    def prepare(folder: Path) -> list[str]:
        write_capture(folder / "capture.npz", seen_by(ring(count), frames))
        return [SOLVER, "solve", "capture.npz", "--out", "motion.npz", "--report", "report.html"]

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
    return [SOLVER, "info", "."]


def many_files(folder: Path, count: int = 100_000) -> list[str]:
    """Write four cameras of one person as so many files of OpenPose."""
    cameras = ring(4)
    keypoints = seen_by(cameras, count // len(cameras)).require_multiview()[1]
    write_detections(folder / "pose", cameras.names, [(keypoints.xy, keypoints.confidence)])
    _describe(folder, cameras)
    return [SOLVER, "info", "."]


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
    return [SOLVER, "solve", "take.c3d", "--out", "motion.npz", "--report", "report.html"]


def batch(folder: Path, count: int = 300, frames: int = 16) -> list[str]:
    """Write so many short captures."""
    (folder / "captures").mkdir()
    first = folder / "captures" / "000.npz"
    write_capture(first, cut(demo_capture(frames), 0, frames))
    for number in range(1, count):
        os.link(first, folder / "captures" / f"{number:03d}.npz")
    (folder / "job.json").write_text(json.dumps({"version": 1, "settings": _QUICK}))
    return [ADDON, "batch", "captures", "--out", "out", "--job", "job.json"]


INPUTS: dict[str, Callable[[Path], list[str]]] = {
    "200 cameras": _views(200, 60),
    "500 people": crowd,
    "1000 labels": many_labels,
    "100000 files": many_files,
    "batch of 30": lambda folder: batch(folder, 30),
    "batch of 300": batch,
    "8 views 2250 frames": _views(8, 2_250),
    "8 views 9000 frames": _views(8, 9_000),
    "8 views 36000 frames": _views(8, 36_000),
}
"""By name."""
