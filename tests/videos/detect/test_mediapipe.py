"""MediaPipe's pose model on recorded videos, by MediaPipe or by LiteRT, where its environment has been made."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.load import load_capture
from solver_backend.videos.detect.detect_videos import joint_set_of
from solver_backend.videos.detect.detector import DetectorChoice, DetectorMissing, DetectorProcess, chosen_detector
from solver_backend.videos.files.video import probe, read_pictures

TRIAL = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
PARTS = ("shoulder", "elbow", "wrist", "knee", "ankle")
PICTURES = 6


POSE_MODEL, LITERT_PYTHON = "MANIFOLD_MOCAP_POSE_MODEL", "MANIFOLD_MOCAP_LITERT_PYTHON"
"""Environment variables that name pose_landmark_full.tflite and a Python with ai-edge-litert, for the test alone."""


def choice_of(detector: str) -> DetectorChoice:
    """Return a detector; skip where it is not there."""
    if detector == "mediapipe":
        try:
            return chosen_detector()
        except DetectorMissing as missing:
            pytest.skip(str(missing))
    if not os.environ.get(POSE_MODEL) or not os.environ.get(LITERT_PYTHON):
        pytest.skip(f"{POSE_MODEL} and {LITERT_PYTHON} name no model and no Python")
    return chosen_detector(os.environ[POSE_MODEL], python=Path(os.environ[LITERT_PYTHON]))


@pytest.mark.slow
@pytest.mark.parametrize("detector", ["mediapipe", "litert"])
def test_the_model_agrees_with_openpose_on_a_recorded_trial(detector: str, shared_data: Path) -> None:
    pytest.importorskip("av")
    choice = choice_of(detector)
    reference = load_capture(shared_data / TRIAL).keypoints
    assert reference is not None
    apart = []
    for camera in (1, 4):
        info = probe(shared_data / TRIAL / "videos" / f"cam0{camera}.mp4")
        with DetectorProcess(choice) as process:
            names = joint_set_of(process.about).keypoints
            columns = [k for k, name in enumerate(names) if name.endswith(PARTS)]
            theirs = [reference.joint_set.keypoints.index(names[k]) for k in columns]
            for picture in islice(read_pictures(info), PICTURES):
                [person] = process.detect(picture.rgb, picture.time_s)["keypoints"]
                apart.append(
                    np.linalg.norm(person[columns, :2] - reference.xy[camera - 1, picture.number, theirs], axis=-1)
                )
    assert np.nanmedian(apart) < 25.0  # of a person some 900 px tall; 17 px over the whole trial
