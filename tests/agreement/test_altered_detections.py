"""Detections that a program filled, rounded or smoothed are named. Those of a detector never are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.repeated_frames import filled_frames, grids_px, smoothing_s
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
    assert not filled_frames(PART).any() and not grids_px(PART).any()
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
    assert "In camera cam02, all keypoints move along straight lines" in sentence(altered)
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


def test_keypoints_on_a_coarse_grid_are_named() -> None:
    seen = replace(PART, xy=np.where([[[[True]]], [[[False]]], [[[True]]], [[[True]]]], PART.xy, 0.0))
    seen = replace(seen, xy=np.where(seen.xy == 0.0, np.round(PART.xy / 32) * 32, seen.xy))
    np.testing.assert_array_equal(grids_px(seen), [0, 32, 0, 0])
    assert not grids_px(replace(PART, xy=np.round(PART.xy))).any()  # whole pixels are no fault
    sound = np.round(PART.xy[0, :2] / 32) * 32
    few = replace(PART.at(slice(0, 2)), xy=np.broadcast_to(sound, (4, *sound.shape)))
    assert not grids_px(few).any()


def swinging() -> np.ndarray:
    """Return points of arms that swing by 60 degrees at 1 Hz, seen 60 times per second with 2 mm noise."""
    time, rng = np.arange(240) / 60, np.random.default_rng(0)
    names = KEYPOINTS.joint_set.keypoints
    points = rng.normal(0, 0.002, (240, len(names), 3))
    angle = np.radians(60) * np.sin(2 * np.pi * time)
    for side in ("left", "right"):
        for joint, down in (("knee", 0.4), ("ankle", 0.8)):
            points[:, names.index(f"{side}_{joint}"), 2] -= down
        for joint, reach in (("elbow", 0.3), ("wrist", 0.55)):
            arm = reach * np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
            points[:, names.index(f"{side}_{joint}")] += arm
    return points


@pytest.mark.parametrize(("frames", "expected"), [(1, 0.0), (15, 15 / 60 / np.sqrt(12))])
def test_the_deviation_of_a_filter_shows_in_limbs_that_rotate(frames: int, expected: float) -> None:
    points = np.apply_along_axis(np.convolve, 0, swinging(), np.full(frames, 1 / frames), "valid")
    assert smoothing_s(points, KEYPOINTS.joint_set, 60.0) == pytest.approx(expected, rel=0.25)


def test_limbs_that_nobody_sees_show_no_filter() -> None:
    points = np.random.default_rng(0).normal(size=(100, KEYPOINTS.joint_set.num_keypoints, 3))
    points[:, [KEYPOINTS.joint_set.keypoints.index(f"left_{joint}") for joint in ("shoulder", "elbow", "wrist")]] = (
        np.nan
    )
    assert np.isfinite(smoothing_s(points, KEYPOINTS.joint_set, 60.0))
    assert smoothing_s(np.full_like(points, np.nan), KEYPOINTS.joint_set, 60.0) == 0.0


def test_a_single_limb_that_shortens_with_its_speed_is_no_smoothing() -> None:
    points, names = swinging(), KEYPOINTS.joint_set.keypoints
    upper, lower = names.index("left_elbow"), names.index("left_wrist")
    limb = points[:, lower] - points[:, upper]
    speed = 60 * np.linalg.norm(np.gradient(limb / np.linalg.norm(limb, axis=-1, keepdims=True), axis=0), axis=-1)
    points[:, lower] = points[:, upper] + (1.0 - 0.5 * (0.1 * speed) ** 2)[:, None] * limb  # As after 0.1 s.
    assert smoothing_s(points, KEYPOINTS.joint_set, 60.0) == 0.0
