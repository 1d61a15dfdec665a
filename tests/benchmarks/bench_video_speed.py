"""Speed of the included detector and of a whole take: four cameras, 10 s at 30 pictures per second, 1080 x 1920 pixels.

The take plays every second picture of Pose2Sim's balancing videos forwards and backwards. One run finds the bodies. The
second run adds hands, cameras from the person, capture, motion and report: ``POSE_MODEL=pose_landmark_full.tflite
HAND_MODEL=hand_landmark_full.tflite LITERT_PYTHON=litert/bin/python python3 dev.py bench video_speed``. Times are of
the wall clock, so the machine must be idle. ``VIDEO_SPEED_S`` sets another length.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from solver_backend.geometry.parallel import usable_cores
from solver_backend.videos.files.video import probe, read_pictures, write_video
from tests.benchmarks.metric import BenchmarkSkipped, Metric
from tests.support.recordings import BALANCING_TRIAL, recordings_folder

FPS, STEP = 30.0, 2  # Pictures per second of the take, and video pictures per picture of the take.


def run() -> list[Metric]:
    """Measure, print and return the figures."""
    models, python = [os.environ.get(name) for name in ("POSE_MODEL", "HAND_MODEL")], os.environ.get("LITERT_PYTHON")
    videos = sorted((recordings_folder() / BALANCING_TRIAL / "videos").glob("*.mp4"))
    if not all(models) or not python or not videos:
        raise BenchmarkSkipped("POSE_MODEL, HAND_MODEL, LITERT_PYTHON or the recordings are missing")
    frames = round(float(os.environ.get("VIDEO_SPEED_S", 10.0)) * FPS)
    with tempfile.TemporaryDirectory() as temporary:
        for video in videos:
            _film(video, Path(temporary, video.name), frames)
        words = ["from-videos", temporary, "--detector", str(models[0]), "--python", python]
        words += ["--hand-model", str(models[1]), "--hand-python", python]
        detect_s, detect_cpu_s = _timed([*words, "--until", "detect"])
        rest_s, rest_cpu_s = _timed(words)
    count = frames * len(videos)
    sys.stdout.write(
        f"  {frames} pictures of {len(videos)} cameras, {usable_cores()} cores: detection {detect_s:.1f} s "
        f"({detect_cpu_s:.1f} s CPU), the rest {rest_s:.1f} s ({rest_cpu_s:.1f} s CPU)\n"
    )
    return [
        Metric("pictures_per_s_per_camera", frames / detect_s, "fps", "higher", rel_tol=0.3),
        Metric("pictures_per_s", count / detect_s, "fps", "higher", rel_tol=0.3),
        Metric("take_s", detect_s + rest_s, "s", rel_tol=0.3),
        Metric("take_cpu_s", detect_cpu_s + rest_cpu_s, "s", rel_tol=0.3),
    ]


def _film(source: Path, path: Path, frames: int) -> None:
    """Write a video of a source's pictures, forwards and backwards."""
    pictures = [picture.rgb for picture in read_pictures(probe(source))][::STEP]
    there_and_back = [*pictures, *pictures[-2:0:-1]]
    write_video(path, (there_and_back[k % len(there_and_back)] for k in range(frames)), FPS)


def _timed(words: list[str]) -> tuple[float, float]:
    """Run a verb, and return its seconds and CPU seconds."""
    began, cpu = time.perf_counter(), _children_s()
    subprocess.run([sys.executable, "-m", "solver_backend", *words], check=True, capture_output=True)
    return time.perf_counter() - began, _children_s() - cpu


def _children_s() -> float:
    spent = os.times()
    return spent.children_user + spent.children_system
