"""Detections that a program filled are named. Those of a detector never are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.agreement.repeated_frames import filled_frames
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Remedy, sentence
from solver_backend.exchange.progress import silent
from solver_backend.fitters.measurements.sanitise import check_capture
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Keypoints2D

DEMO = demo_capture()
CAMERAS, KEYPOINTS = DEMO.require_multiview()
PART = KEYPOINTS.at(slice(0, 120))


def with_gap(view: int, first: int, last: int) -> Keypoints2D:
    xy = PART.xy.copy()
    share = np.linspace(0, 1, last - first + 1)[:, None, None]
    xy[view, first : last + 1] = (1 - share) * xy[view, first] + share * xy[view, last]
    confidence = np.where(np.isfinite(xy).all(-1), np.maximum(PART.confidence, 0.1), 0.0)
    return replace(PART, xy=xy, confidence=confidence)


def test_a_gap_filled_with_straight_lines_is_left_out() -> None:
    assert not filled_frames(PART).any()
    seen = with_gap(1, 40, 90)
    filled = filled_frames(seen)
    assert filled[1, 41:90].all() and filled.sum() == 49
    time = np.arange(120)[:, None]
    sway = np.stack([5 * np.sin(0.05 * time), 0 * time], -1) + PART.xy[:, :1]
    assert not filled_frames(replace(PART, xy=sway)).any()  # exact and slow, but no line
    assert not filled_frames(with_gap(1, 40, 45)).any()  # a short one does no harm
    capture = replace(DEMO, keypoints=seen, people=())
    found = check_capture(capture, triangulate(CAMERAS, seen.xy, seen.confidence), silent)
    (altered,) = [item for item in found.diagnostics if item.code == "detections_altered"]
    assert (altered.where.cameras, altered.where.frames, altered.remedy) == (("cam02",), ((41, 89),), Remedy.EXCLUDED)
    assert "Camera cam02: keypoints move in straight lines" in sentence(altered)
    assert not any(item.code in ("camera_late", "camera_turned") for item in found.diagnostics)


def test_frames_that_are_filled_in_all_views_are_kept_and_named() -> None:
    keys = np.arange(0, 121, 12)
    frame = np.arange(keys[-1])
    share = (frame % 12 / 12)[:, None, None]
    known = np.where(np.isfinite(KEYPOINTS.xy), KEYPOINTS.xy, 0.0)
    xy = (1 - share) * known[:, keys[frame // 12]] + share * known[:, keys[frame // 12 + 1]]
    seen = replace(PART, xy=xy, confidence=np.ones(xy.shape[:-1]))
    assert filled_frames(seen).mean() > 0.8
    capture = replace(DEMO, keypoints=seen, people=())
    found = check_capture(capture, triangulate(CAMERAS, seen.xy, seen.confidence), silent)
    altered = [item for item in found.diagnostics if item.code == "detections_altered"]
    assert altered and Remedy.EXCLUDED not in {item.remedy for item in altered}
    assert np.isfinite(found.triangulation.points).all(-1).any(1).mean() > 0.9


def test_one_keypoint_that_moves_along_a_line_is_no_filled_gap() -> None:
    line = 3.0 * np.arange(120)[:, None, None] * np.ones(2)
    alone = np.zeros_like(PART.confidence)
    alone[..., 0] = 0.9
    assert not filled_frames(replace(PART, xy=np.broadcast_to(line, PART.xy.shape), confidence=alone)).any()
