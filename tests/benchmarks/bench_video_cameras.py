"""Estimate cameras of uncalibrated videos from the person alone, with unknown lenses, on a real take.

Pose2Sim's balancing trial is used with all four views, and with each three of them. MediaPipe's models run under
LiteRT, as in the extension: ``POSE_MODEL=pose_landmark_full.tflite LITERT_PYTHON=litert/bin/python python3 dev.py bench
video_cameras``. The truth is the trial's calibration. Its size is compared by the person's triangulated keypoints.
"""

from __future__ import annotations

import os
import sys
import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np

from solver_backend.camera_calibration.calibration_check import check_calibration
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.geometry.alignment import umeyama
from solver_backend.io.calibration.search import find_calibration
from solver_backend.io.native.capture_file import read_capture
from solver_backend.types import Cameras, Keypoints2D
from solver_backend.videos.detect.detect_videos import detect_videos
from solver_backend.videos.detect.detector import chosen_detector
from solver_backend.videos.pipeline.calibrate import KnownOfCameras
from solver_backend.videos.pipeline.layout import look_through
from solver_backend.videos.pipeline.plan import PipelineSettings, planned
from solver_backend.videos.pipeline.run import run_take
from tests.benchmarks.bench_calibration import apart
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import BALANCING_TRIAL, recordings_folder

STATURE_M = 1.72  # Stature of the person that Pose2Sim's trial states.


def run() -> list[Metric]:
    """Measure, print and return the figures."""
    model, python = os.environ.get("POSE_MODEL"), os.environ.get("LITERT_PYTHON")
    videos = sorted((recordings_folder() / BALANCING_TRIAL / "videos").glob("*.mp4"))
    if not model or not python or not videos:
        raise BenchmarkSkipped("POSE_MODEL, LITERT_PYTHON or the recordings are missing")
    choice = chosen_detector(model, python=Path(python))
    metrics = []
    with tempfile.TemporaryDirectory() as temporary:
        kept = Path(temporary, "detections")
        detect_videos(videos, choice, kept)
        for name, count, stature in (("four", 4, None), ("four_with_stature", 4, STATURE_M), ("three", 3, None)):
            rows = []
            for k, chosen in enumerate(combinations(videos, count)):
                take = Path(temporary, f"{name}_{k}")
                _lay_out(take, chosen, kept)
                [plan] = planned(look_through(take), take / "mocap")
                cameras = KnownOfCameras(stature_m=stature)
                run_take(look_through(take), plan, PipelineSettings(choice, until="capture", cameras=cameras))
                found, keypoints = read_capture(plan.output("capture")).require_multiview()
                rows.append(_row(found, keypoints, find_calibration(_calibration(), found.names).cameras))
                sys.stdout.write(f"  {name} {' '.join(found.names)}: {_words(rows[-1])}\n")
                sys.stdout.flush()
            worst = np.abs(rows).max(axis=0)
            metrics += [
                Metric(f"{name}_{key}", float(value), unit, rel_tol=0.1, abs_tol=0.5)
                for (key, unit), value in zip(_FIGURES.items(), worst, strict=True)
            ]
    return metrics


_FIGURES = {
    "px": "px", "calibrated_px": "px", "size_percent": "%", "centres_mm": "mm", "directions_deg": "deg",
    "keypoints_mm": "mm",
}  # fmt: skip


def _lay_out(take: Path, videos: tuple[Path, ...], kept: Path) -> None:
    (take / "videos").mkdir(parents=True)
    (take / "mocap" / "detections").mkdir(parents=True)
    for video in videos:
        (take / "videos" / video.name).symlink_to(video)
        for path in kept.glob(f"{video.stem}_*"):
            (take / "mocap" / "detections" / path.name).symlink_to(path)


def _calibration() -> Path:
    return recordings_folder() / BALANCING_TRIAL.parents[1] / "S00_Calibration"


def _row(found: Cameras, keypoints: Keypoints2D, true: Cameras) -> list[float]:
    """Return the values of ``_FIGURES``. The size error is positive if the size is too large."""
    points, truth = (np.asarray(triangulate(c, keypoints.xy, keypoints.confidence).points) for c in (found, true))
    both = np.isfinite(points).all(-1) & np.isfinite(truth).all(-1)
    scale, R, t = umeyama(points[both], truth[both], with_scale=True)
    left = np.linalg.norm(scale * points[both] @ np.asarray(R).T + t - truth[both], axis=1)
    far, turned = apart(found, true.R, true.t, with_scale=True)
    px = [check_calibration(cameras, keypoints).all_px for cameras in (found, true)]
    return [*px, 100 * (1 / float(scale) - 1), float(far.max()), float(turned.max()), 1000 * float(np.median(left))]


def _words(row: list[float]) -> str:
    return ", ".join(f"{key} {value:.1f}" for key, value in zip(_FIGURES, row, strict=True))
