"""CPU time for detecting two hands per picture in both processes, without decoding, and the number of hands found.

On Pose2Sim's balancing videos (four views, palms of 35 to 60 px), with MediaPipe's hand model under LiteRT:
``HAND_MODEL=hand_landmark_full.tflite LITERT_PYTHON=litert/bin/python python3 dev.py bench hand_detection``. Cutting a
crop needs neither and is always measured.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import numpy as np

from solver_backend.io.load import load_capture
from solver_backend.types import Capture
from solver_backend.videos.detect.detector import chosen_hand_detector
from solver_backend.videos.detect.find_hands import SIDE, find_hands, pictures_of, second_crop, seen_by
from tests.benchmarks.metric import Metric
from tests.support.recordings import recordings_folder

TAKE = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
CUTS = 60


def run() -> list[Metric]:
    """Measure, print and return the figures."""
    figures = [Metric("crop_ms", _crop_ms(), "ms", rel_tol=0.5)]
    model, python, take = os.environ.get("HAND_MODEL"), os.environ.get("LITERT_PYTHON"), recordings_folder() / TAKE
    if not model or not python or not take.exists():
        sys.stdout.write("  no HAND_MODEL, LITERT_PYTHON or recordings: crops alone are measured\n")
        return figures
    capture = load_capture(take)
    decoding = _cpu_s()
    for _ in pictures_of(capture):
        pass
    decoding = _cpu_s() - decoding
    spent = _cpu_s()
    found = find_hands(capture, chosen_hand_detector(Path(model), python=Path(python)))
    spent = _cpu_s() - spent - decoding
    shares = seen_by(found, 2)
    sys.stdout.write(f"  seen by two views: {shares}\n")
    pictures = _num_pictures(capture)
    return [
        *figures,
        Metric("two_hands_ms", 1000.0 * spent / pictures, "ms", rel_tol=0.3),
        *(Metric(f"{side}_found_percent", share, "%", "higher") for side, share in shares.items()),
    ]


def _num_pictures(capture: Capture) -> int:
    return capture.num_frames * sum(path is not None for path in capture.footage)


def _crop_ms() -> float:
    """Return the median CPU time in milliseconds for cropping a hand in a large picture."""
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    crop, took = second_crop(np.array([900.0, 500.0]) + rng.uniform(-40, 40, (21, 2)), 0), list[float]()
    for _ in range(CUTS):
        began = time.process_time()
        crop.cut(rgb, SIDE, 0.0)
        took.append(time.process_time() - began)
    return 1000.0 * float(np.median(took))


def _cpu_s() -> float:
    """Return CPU seconds of this process and of its ended children."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system
