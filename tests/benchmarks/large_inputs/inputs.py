"""Large inputs. Each function fills a folder and returns the program's module and arguments."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.io.markers.c3d import write_c3d
from solver_backend.io.native.capture_file import write_capture
from solver_backend.synthesis.embedded.demo import demo_capture, record_markers
from solver_backend.types import Cameras, JointSet, MarkerCloud
from tests.support.calibration_files import toml_text
from tests.support.many_views import ring, seen_by
from tests.support.scenes import detected, walker
from tests.support.short_solves import cut
from tests.support.trial_files import write_detections

SOLVER, ADDON = "solver_backend", "blender_addon"
_SOLVED = ("--out", "motion.npz", "--report", "report.html")
_COLUMNS, _MARKER_FRAMES = 1000, 600
"""Columns and frames of a marker take."""
_QUICK = {"iterations": 1, "residual_rotations": False, "contacts": False, "learn_noise": False}


def _views(count: int, frames: int) -> Callable[[Path], list[str]]:
    def prepare(folder: Path) -> list[str]:
        write_capture(folder / "capture.npz", seen_by(ring(count), frames))
        return [SOLVER, "solve", "capture.npz", *_SOLVED]

    return prepare


def crowd(folder: Path, count: int = 500, frames: int = 20) -> list[str]:
    """Write four cameras that each see ``count`` people, 0.8 m apart, as OpenPose files."""
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


def crowd_to_solve(folder: Path) -> list[str]:
    """Write a crowd whose main person is solved."""
    return [SOLVER, "solve", *crowd(folder)[2:], *_SOLVED]


def many_files(folder: Path, count: int = 100_000) -> list[str]:
    """Write four cameras of one person as ``count`` OpenPose files."""
    cameras = ring(4)
    keypoints = seen_by(cameras, count // len(cameras)).require_multiview()[1]
    write_detections(folder / "pose", cameras.names, [(keypoints.xy, keypoints.confidence)])
    _describe(folder, cameras)
    return [SOLVER, "info", "."]


def _describe(folder: Path, cameras: Cameras) -> None:
    (folder / "calibration").mkdir()
    (folder / "calibration" / "Calib.toml").write_text(toml_text(cameras))
    (folder / "Config.toml").write_text("[project]\nframe_rate = 60\n")


def _worn() -> MarkerCloud:
    """Return one person's markers, with labels without a prefix."""
    cloud = record_markers(_MARKER_FRAMES, seed=5).cloud
    return replace(cloud, labels=tuple(label.rpartition(":")[2] for label in cloud.labels or ()))


def many_labels(*words: str, known: bool = False, named: bool = True) -> Callable[[Path], list[str]]:
    """Return a function that writes ten seconds of one person's markers among other points, with 1,000 columns in all.

    Args:
        words: words that are typed after the file.
        known: the person's labels belong to a layout. Otherwise they belong to none, like the other points.
        named: the points have labels.
    """

    def prepare(folder: Path) -> list[str]:
        worn = _worn()
        own = worn.positions.shape[1]
        strays = np.random.default_rng(0).uniform([-3, -3, 0], [3, 3, 2.5], (1, _COLUMNS - own, 3))
        cloud = np.concatenate([worn.positions, np.repeat(strays, _MARKER_FRAMES, axis=0)], axis=1)
        labels = tuple((worn.labels or ())[i] if known and i < own else f"M{i:04d}" for i in range(_COLUMNS))
        write_c3d(folder / "take.c3d", MarkerCloud(cloud.astype(np.float32), worn.fps, labels if named else None))
        return [SOLVER, words[0], "take.c3d", *words[1:]]

    return prepare


def fragments(folder: Path) -> list[str]:
    """Write one person's markers without names, with each part between two gaps in a separate column."""
    worn = _worn().positions
    pieces = _COLUMNS // worn.shape[1]
    edges = np.linspace(0, len(worn), pieces + 1).astype(int)
    cloud = np.full((len(worn), worn.shape[1] * pieces, 3), np.nan, np.float32)
    for m in range(worn.shape[1]):
        for k in range(pieces):  # three frames of every piece are missing
            cloud[edges[k] : edges[k + 1] - 3, m * pieces + k] = worn[edges[k] : edges[k + 1] - 3, m]
    write_c3d(folder / "take.c3d", MarkerCloud(cloud, 60.0))
    return [SOLVER, "solve", "take.c3d", *_SOLVED]


def ten_people(folder: Path) -> list[str]:
    """Write ten people's markers with prefixes, and as many columns of unnamed fragments."""
    worn, rng = _worn(), np.random.default_rng(0)
    own = worn.positions.shape[1]
    places = np.array([[1.5 * (i % 5), 2.0 * (i // 5), 0.0] for i in range(10)])
    people = (worn.positions[:, None] + places[:, None]).reshape(len(worn.positions), -1, 3)
    fragments = np.full((len(people), _COLUMNS - 10 * own, 3), np.nan)
    for column in range(fragments.shape[1]):
        first, of = rng.integers(len(people) - 20), rng.integers(people.shape[1])
        fragments[first : first + 20, column] = people[first : first + 20, of] + 0.02
    labels = (*(f"P{i}:{label}" for i in range(10) for label in worn.labels or ()),
              *(f"*{k}" for k in range(fragments.shape[1])))  # fmt: skip
    cloud = np.concatenate([people, fragments], axis=1).astype(np.float32)
    write_c3d(folder / "take.c3d", MarkerCloud(cloud, worn.fps, labels))
    return [SOLVER, "solve", "take.c3d", "--subject-prefix", "P3", *_SOLVED]


def batch(folder: Path, count: int = 300, frames: int = 16) -> list[str]:
    """Write ``count`` short captures."""
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
    "500 people to solve": crowd_to_solve,
    "1000 labels of no layout": many_labels("solve", *_SOLVED),
    "1000 labels with a person": many_labels("solve", *_SOLVED, known=True),
    "1000 points without names": many_labels("solve", *_SOLVED, named=False),
    "1000 points to label": many_labels("markers label", "--out", "named.c3d", named=False),
    "one person in 1000 fragments": fragments,
    "ten people of 1000 labels": ten_people,
    "100000 files": many_files,
    "batch of 30": lambda folder: batch(folder, 30),
    "batch of 300": batch,
    "8 views 2250 frames": _views(8, 2_250),
    "8 views 4500 frames": _views(8, 4_500),
    "8 views 9000 frames": _views(8, 9_000),
    "8 views 18000 frames": _views(8, 18_000),
    "8 views 36000 frames": _views(8, 36_000),
}
"""Inputs by name."""
