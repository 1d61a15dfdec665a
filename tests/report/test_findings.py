"""Each fault is found and named once; a clean solve has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.report.faults import frames_text
from solver_backend.report.findings import findings_of, listed
from solver_backend.report.statistics import residuals_of
from tests.support.solved import GAP, OFF, solved


def sentences(capture, motion) -> list[str]:
    return [finding.what for finding in findings_of(capture, motion, residuals_of(capture, motion))]


def test_a_clean_solve_has_nothing_to_look_at():
    assert sentences(*solved(faults=False)) == []


def test_every_fault_is_named():
    capture, motion = solved()
    found = sentences(replace(capture, problems=("A camera was trimmed.",)), motion)
    assert found[0] == "A camera was trimmed."
    assert any(f"frames {GAP[0]}-{GAP[1]} (0.50 s)" in line and "bridged" in line for line in found)
    assert any(f"frames {OFF[0]}-{OFF[1]} (0.20 s)" in line and "far from the detections" in line for line in found)
    assert "Camera cam_c disagrees with the others: 9.0 px against 2.0 px." in found
    assert "Often an outlier: left shoulder in cam_a (33 %)." in found
    assert "Seldom detected by two cameras: nose (0 %)." in found
    assert len(found) == 6


def test_a_camera_that_sees_little_is_named():
    capture, motion = solved(faults=False)
    confidence = capture.keypoints.confidence.copy()
    confidence[1, ::2] = 0.0
    confidence[1, :9] = 0.0
    capture = replace(capture, keypoints=replace(capture.keypoints, confidence=confidence))
    assert sentences(capture, motion) == ["Camera cam_b detects only 46 % of the keypoints."]


def test_feet_below_the_floor_and_sliding_feet_are_named():
    capture, motion = solved(faults=False)
    sunk = sentences(capture, replace(motion, joints=motion.joints - [0.0, 0.0, 0.2]))
    assert "A foot goes 17 cm below the floor." in sunk
    joints = motion.joints.copy()
    joints[:, 10:12, 1] += 0.03 * np.arange(len(joints))[:, None]
    joints[:, 10:12, 2] = 0.0
    assert any("The feet slide by" in line for line in sentences(capture, replace(motion, joints=joints)))


def test_many_stretches_are_counted():
    runs = [(10 * n, 10 * n + n) for n in range(10)]
    text = frames_text(runs, 10.0)
    assert text.startswith("frames 40-44 (0.50 s), frames 50-55")
    assert text.endswith("frames 90-99 (1.00 s) and 4 shorter ones")
    assert frames_text([(3, 3)], 10.0) == "frame 3"


def test_long_lists_are_cut():
    assert listed(["a", "b"]) == "a, b"
    assert listed([*"abcdefgh"]) == "a, b, c, d, e, f and 2 more"
