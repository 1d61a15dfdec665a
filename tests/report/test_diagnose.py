"""Each fault is found and named once; a clean solve has none."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.diagnostics import Severity, diagnostic, word
from solver_backend.report.checks import _cameras, diagnose
from solver_backend.report.statistics import KeypointResiduals
from solver_backend.types import FLAG_UNSURE
from tests.support.solved import GAP, OFF, solved


def sentences(capture, motion) -> list[str]:
    noted = diagnostic("scene_message", severity=Severity.NOTE, text="Read as metres.")
    return [word(item, motion.fps).what for item in diagnose(capture, motion) if item != noted]


def test_a_clean_solve_has_nothing_to_look_at():
    assert sentences(*solved(faults=False)) == []


def test_every_fault_is_named():
    capture, motion = solved()
    found = sentences(replace(capture, problems=(diagnostic("scene_message", text="A camera was trimmed."),)), motion)
    assert found[0] == "A camera was trimmed."
    assert any(f"frames {GAP[0]}-{GAP[1]} (0.50 s)" in line and "interpolated" in line for line in found)
    assert any(f"frames {OFF[0]}-{OFF[1]} (0.20 s)" in line and "far from the detections" in line for line in found)
    assert "Camera cam_c disagrees with the others. Its error is 9.0 px, but 2.0 px is usual." in found
    assert "The detections of some keypoints are often wrong: left shoulder in cam_a (33 %)." in found
    assert "Some keypoints are rarely detected: nose (0 %)." in found
    assert len(found) == 6


def test_a_camera_that_sees_little_is_named():
    capture, motion = solved(faults=False)
    confidence = capture.keypoints.confidence.copy()
    confidence[1, ::2] = 0.0
    confidence[1, :9] = 0.0
    capture = replace(capture, keypoints=replace(capture.keypoints, confidence=confidence))
    assert sentences(capture, motion) == ["In camera cam_b, only 46 % of the keypoints are detected."]


def test_a_motion_that_holds_what_was_found_holds_it_once():
    capture, motion = solved()
    found = diagnose(capture, motion)
    record = json.loads(json.dumps({"diagnostics": [item.as_dict() for item in found]}))
    assert diagnose(capture, replace(motion, provenance=record)) == found


def test_frames_that_are_hardly_known_are_a_warning_where_they_are_many():
    capture, motion = solved(faults=False)
    flags = np.zeros(motion.num_frames, np.uint8)
    flags[3] = FLAG_UNSURE
    (few,) = (item for item in diagnose(capture, replace(motion, flags=flags)) if "unsure" in item.code)
    flags[3:9] = FLAG_UNSURE
    (many,) = (item for item in diagnose(capture, replace(motion, flags=flags)) if "unsure" in item.code)
    assert (few.severity, many.severity) == (Severity.NOTE, Severity.WARNING)
    assert many.where.frames == ((3, 8),)


def test_a_body_without_a_left_leg_has_neither_stature_nor_feet_to_check():
    capture, motion = solved(faults=False)
    layout = SMPL.without(("left_hip", "left_knee", "left_ankle", "left_foot"), "one leg")
    kept = [SMPL.joints.index(name) for name in layout.joints]
    pose = np.zeros((motion.num_frames, 3 * (layout.num_joints - 1)))
    sunk = replace(motion, joints=3 * motion.joints[:, kept] - 1.0, body_pose=pose, body_layout=layout)
    assert not {"stature_odd", "feet_off_floor"} & {item.code for item in diagnose(capture, sunk)}


def test_pictures_of_another_size_are_compared_as_angles():
    """Of twice the size, the same error is twice as many pixels."""
    capture, motion = solved()
    K = capture.cameras.K.copy()
    K[2, [0, 1], [0, 1]] *= 4.5
    larger = replace(capture, cameras=replace(capture.cameras, K=K))
    assert "camera_disagrees" in [item.code for item in diagnose(capture, motion)]
    assert "camera_disagrees" not in [item.code for item in diagnose(larger, motion)]


def test_a_camera_near_the_person_may_be_off_by_more_pixels():
    capture, motion = solved()
    errors = np.full((4, 1, 1), 2.0)
    errors[2] = 9.0
    near = capture.cameras.t * np.array([1.0, 1.0, 1 / 4.5])[None] ** (np.arange(4) == 2)[:, None]
    for cameras, expected in ((capture.cameras, ["camera_disagrees"]), (replace(capture.cameras, t=near), [])):
        found = _cameras(replace(capture, cameras=cameras), motion, KeypointResiduals(errors, np.full(1, 50.0)))
        assert [item.code for item in found] == expected
