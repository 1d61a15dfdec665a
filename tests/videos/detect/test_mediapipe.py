"""MediaPipe on recorded videos, where its environment has been made."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from solver_backend.io.load import load_capture
from solver_backend.videos.detect.choice import chosen_detector
from solver_backend.videos.detect.detect_videos import joint_set_of
from solver_backend.videos.detect.errors import DetectorMissing
from solver_backend.videos.detect.process import DetectorProcess
from solver_backend.videos.files.probe import probe
from solver_backend.videos.files.read import read_pictures

TRIAL = "multiview/pose2sim/S00_P00_SingleParticipant/S00_P00_T01_BalancingTrial"
PARTS = ("shoulder", "elbow", "wrist", "knee", "ankle")
PICTURES = 6


@pytest.mark.slow
def test_mediapipe_agrees_with_openpose_on_a_recorded_trial(shared_data: Path) -> None:
    pytest.importorskip("av")
    try:
        choice = chosen_detector()
    except DetectorMissing as missing:
        pytest.skip(str(missing))
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
