"""What is said about captures and motions."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from solver_backend.body.markers import marker_layout
from solver_backend.cli.describe import describe_capture, describe_motion, frames_without_two_views
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, Capture, Keypoints2D
from tests.support.scenes import small_capture, small_markers, small_motion
from tests.support.worn_markers import worn_markers

LEGS = ("FWT", "BWT", "THI", "KNE", "SHN", "ANK", "HEE", "MT5", "TOE")


def seen_in(capture: Capture, seen: np.ndarray) -> Capture:
    assert capture.keypoints is not None
    old = capture.keypoints
    confidence = np.where(seen[..., None], 1.0, 0.0) * np.ones(old.confidence.shape)
    return replace(capture, keypoints=Keypoints2D(np.nan_to_num(old.xy), confidence, old.joint_set, old.fps))


def test_stretches_without_two_views_are_found_at_the_ends_too():
    seen = np.ones((4, 10), dtype=bool)
    seen[:, 0] = False
    seen[1:, 3:6] = False
    seen[:, 9] = False
    capture = seen_in(small_capture(10), seen)
    assert frames_without_two_views(capture) == [[0, 0], [3, 5], [9, 9]]
    text, data = describe_capture(capture)
    assert "no person is seen by two cameras in frames 0-0, 3-5, 9-9. They will be interpolated and flagged" in text
    assert data["bridged_frames"] == [[0, 0], [3, 5], [9, 9]]


def test_each_camera_says_where_it_stands_and_what_it_sees():
    capture = seen_in(small_capture(10), np.arange(10) < np.array([10, 5, 2, 0])[:, None])
    text, data = describe_capture(capture)
    assert [camera["seen_percent"] for camera in data["cameras"]] == [100.0, 50.0, 20.0, 0.0]
    np.testing.assert_allclose([c["position_m"] for c in data["cameras"]], capture.cameras.centres, atol=1e-3)
    assert "cam_b: 1920 x 1080" in text
    assert data["truth"] == ["betas", "joints"]
    json.dumps(data, allow_nan=False)


def test_a_capture_of_markers_alone():
    text, data = describe_capture(Capture(name="ms", markers=small_markers()))
    assert (data["markers"], data["cameras"], data["joint_set"]) == (3, [], None)
    assert "markers     3" in text
    assert "problems    none" in text


def test_a_motion_counts_its_flags():
    flags = np.array([0, FLAG_UNSEEN, FLAG_UNSURE, FLAG_UNSEEN | FLAG_UNSURE, 0, FLAG_UNSURE], np.uint8)
    text, data = describe_motion(replace(small_motion(), flags=flags), 1.5)
    assert (data["unseen_frames"], data["unsure_frames"]) == (2, 3)
    assert "3 frames far from the detections or very uncertain, 2 interpolated" in text
    json.dumps(data, allow_nan=False)
    assert describe_motion(small_motion(optional=False), 0.0)[1]["reprojection_median_px"] is None


def test_parts_without_known_markers_are_named_before_a_solve():
    legs = [label for label in marker_layout("CMU_41") if label[1:] in LEGS]
    text, data = describe_capture(Capture("legs", markers=worn_markers(legs, 8).cloud))
    assert "Arms, trunk and head: they have no known markers and stay at rest in a solve" in text
    assert {"left_forearm", "head", "trunk"} <= set(data["marker_names"]["resting"])
    whole, data = describe_capture(Capture("whole", markers=worn_markers(marker_layout("CMU_41"), 8).cloud))
    assert "at rest" not in whole and "resting" not in data["marker_names"]
