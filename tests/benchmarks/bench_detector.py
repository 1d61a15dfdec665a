"""Compare the included detector on real videos with published OpenPose keypoints, before and after the solve.

Pose2Sim's balancing and static trial, four views each. MediaPipe's models run under LiteRT, as in the extension:
``POSE_MODEL=pose_landmark_full.tflite LITERT_PYTHON=litert/bin/python python3 dev.py bench detector``. OpenPose's
keypoints (BODY_25B) are not ground truth. Their definitions also differ from MediaPipe's.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.fitters.pipeline import solve
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.load import load_capture
from solver_backend.types import Capture
from solver_backend.videos.detect.assemble import assembled
from solver_backend.videos.detect.detect_videos import detect_videos
from solver_backend.videos.detect.detector import chosen_detector
from solver_backend.videos.sync.clocks import Clocks
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import recordings_folder

TRIALS = "multiview/pose2sim/S00_P00_SingleParticipant"
TAKES = ("S00_P00_T01_BalancingTrial", "S00_P00_T00_StaticTrial")
JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "heel", "big_toe")
SURE = 0.5  # Smallest confidence of OpenPose for a visible keypoint.
SEEN = 0.5  # Smallest confidence of the detector for a detected keypoint.
APART = 0.1  # Smallest distance between left and right for comparing sides, as a share of the person's height.
SWAPPED = 0.5  # A keypoint is swapped if the other side is closer than this share of the distance to its side.


@dataclass(frozen=True)
class Against:
    """Distances of keypoints from OpenPose's, for V view frames, J joints and two sides."""

    px: np.ndarray  # (V, J, 2) pixels, NaN if OpenPose's confidence is low.
    missing: np.ndarray  # (V, J) mask of these keypoints if the detector's confidence is low.
    swapped: np.ndarray  # (V, J) mask of keypoints with exchanged sides.
    comparable: np.ndarray  # (V, J) mask of keypoints with sides far enough apart.
    height_px: np.ndarray  # (V,) height of the person.


def run() -> list[Metric]:
    """Measure, print and return the figures."""
    model, python = os.environ.get("POSE_MODEL"), os.environ.get("LITERT_PYTHON")
    folder = recordings_folder() / TRIALS
    if not model or not python or not folder.is_dir():
        raise BenchmarkSkipped("POSE_MODEL, LITERT_PYTHON or the recordings are missing")
    choice, took, pictures = chosen_detector(model, python=Path(python)), 0.0, 0
    before, after = list[Against](), list[Against]()
    for take in TAKES:
        reference = load_capture(folder / take)
        videos = sorted((folder / take / "videos").glob("*.mp4"))
        names = [path.stem for path in videos]
        began = _cpu_s()
        with tempfile.TemporaryDirectory() as kept:
            found = detect_videos(videos, choice, Path(kept), cameras=names)
        took, pictures = took + _cpu_s() - began, pictures + sum(item.num_frames for item in found)
        calibration = find_calibration(folder.parent / "S00_Calibration", tuple(names))
        capture = assembled(take, found, Clocks.alike(tuple(names)), calibration)
        detected = np.concatenate([capture.require_views()[1].xy, capture.require_views()[1].confidence[..., None]], -1)
        before.append(compared(detected, capture, reference))
        after.append(compared(_solved(capture), capture, reference))
    figures = _by_joint(*map(_joined, (before, after)))
    for name, found in (("detected", _joined(before)), ("solved", _joined(after))):
        figures += [
            Metric(f"{name}_px", float(np.nanmedian(found.px)), "px"),
            Metric(f"{name}_percent", float(100 * np.nanmedian(found.px / found.height_px[:, None, None])), "%"),
            Metric(
                f"{name}_swaps_percent", float(100 * found.swapped.sum() / found.comparable.sum()), "%", abs_tol=0.1
            ),
        ]
    missing = _joined(before)
    share = 100 * missing.missing.sum() / np.isfinite(missing.px).sum()
    figures.append(Metric("missing_percent", float(share), "%", abs_tol=0.5))
    return [*figures, Metric("cpu_ms", 1000 * took / pictures, "ms", rel_tol=0.3)]


def compared(points: np.ndarray, capture: Capture, reference: Capture) -> Against:
    """Compare (C, F, K, 3) points of a capture's joint set with OpenPose's."""
    ours, theirs = capture.require_views()[1], reference.require_views()[1]
    frames = min(points.shape[1], theirs.xy.shape[1])
    at, known = (
        np.array([[k.joint_set.keypoints.index(f"{side}_{name}") for side in ("left", "right")] for name in JOINTS])
        for k in (ours, theirs)
    )
    mine = points[:, :frames][:, :, at].reshape(-1, *at.shape, 3)
    sure = (theirs.confidence[:, :frames][:, :, known] >= SURE).reshape(-1, *at.shape)
    truth = theirs.xy[:, :frames][:, :, known].reshape(-1, *at.shape, 2)
    truth = np.where(sure[..., None], truth, np.nan)
    own, other = (np.linalg.norm(mine[..., :2] - t, axis=-1) for t in (truth, truth[:, :, ::-1]))
    height = np.nanmax(truth[..., 1], (1, 2)) - np.nanmin(truth[..., 1], (1, 2))
    comparable = np.linalg.norm(truth[:, :, 0] - truth[:, :, 1], axis=-1) > APART * height[:, None]
    comparable &= np.isfinite(own).all(-1)
    missing = sure & ~(mine[..., 2] >= SEEN)
    return Against(own, missing, comparable & (other.sum(-1) < SWAPPED * own.sum(-1)), comparable, height)


def _solved(capture: Capture) -> np.ndarray:
    """Return the (C, F, K, 3) solved keypoints in the views."""
    points = solve(capture).motion.keypoints3d
    assert points is not None
    px = np.asarray(project(capture.require_views()[0], points))
    return np.concatenate([px, np.ones_like(px[..., :1])], axis=-1)


def _joined(parts: list[Against]) -> Against:
    return Against(*(np.concatenate([getattr(part, name) for part in parts]) for name in Against.__annotations__))


BY_JOINT = {"px": "px", "missing": "%", "swapped": "%", "solved_px": "px", "solved_swapped": "%"}
"""Figures of each joint and their units. Distances are medians."""


def _by_joint(before: Against, after: Against) -> list[Metric]:
    """Print and return the figures of each joint."""
    sys.stdout.write("  joint     " + "".join(f"{key:>15}" for key in BY_JOINT) + "\n")
    metrics = []
    for j, name in enumerate(JOINTS):
        px, solved_px = (np.nanmedian(part.px[:, j]) for part in (before, after))
        swapped, solved = (100 * p.swapped[:, j].sum() / max(p.comparable[:, j].sum(), 1) for p in (before, after))
        missing = 100 * before.missing[:, j].sum() / np.isfinite(before.px[:, j]).sum()
        row = dict(zip(BY_JOINT, map(float, (px, missing, swapped, solved_px, solved)), strict=True))
        sys.stdout.write(f"  {name:<10}" + "".join(f"{value:>15.1f}" for value in row.values()) + "\n")
        metrics += [Metric(f"{name}_{key}", value, BY_JOINT[key], abs_tol=1.0) for key, value in row.items()]
    return metrics


def _cpu_s() -> float:
    """Return CPU seconds of this process and of its ended children."""
    return sum(list(os.times())[:4])
