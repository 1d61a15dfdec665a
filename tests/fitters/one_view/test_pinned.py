"""A person decides where one camera cannot: a pinned pose holds, and its neighbours follow it in depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import read_diagnostics
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.pipeline import resolve_range, solve
from solver_backend.types import Capture, Motion
from tests.support.one_view_situations import LEGS, filmed_walk, without

WRIST, SHOULDER = SMPL_JOINTS.index("left_wrist"), SMPL_JOINTS.index("left_shoulder")
PINNED, FIRST, LAST = 30, 14, 46


def reached(motion: Motion, capture: Capture, frame: int) -> float:
    """Return how far the wrist lies behind the shoulder along the line of sight, metres."""
    cameras, _ = capture.require_views()
    return float((motion.joints[frame, WRIST] - motion.joints[frame, SHOULDER]) @ cameras.R[0, 2])


@pytest.mark.slow
def test_a_pin_decides_whether_an_arm_points_towards_the_camera_or_away_and_its_neighbours_follow() -> None:
    capture = filmed_walk(60)
    motion = solve(capture).motion
    ways = []
    for turn in (0.9, -0.9):
        pose = motion.body_pose[PINNED].copy()
        pose[3 * (SHOULDER - 1) :][:3] += [0.0, turn, 0.0]
        pin = Pin(PINNED, motion.global_orient[PINNED], pose, motion.transl[PINNED])
        again = resolve_range(capture, motion, FrameRange(FIRST, LAST, (pin,))).motion
        assert np.abs(again.body_pose[PINNED, :63] - pose[:63]).max() < 1e-3
        moved = [reached(again, capture, frame) - reached(motion, capture, frame) for frame in (29, PINNED, 31)]
        assert abs(moved[1]) > 0.05 and all(m * moved[1] > 0.6 * moved[1] ** 2 for m in moved)
        assert np.abs(again.joints[:FIRST] - motion.joints[:FIRST]).max() == 0.0
        ways.append(moved[1])
    assert ways[0] * ways[1] < 0.0, "either decision holds"


@pytest.mark.slow
def test_without_floor_and_feet_in_sight_the_result_is_finite_and_says_so() -> None:
    capture = replace(without(filmed_walk(60), LEGS), floor_from_person=True)
    motion = solve(capture).motion
    codes = {item.code for item in read_diagnostics(motion.provenance["diagnostics"])}
    assert np.isfinite(motion.joints).all() and {"one_camera", "parts_at_rest", "up_from_person"} <= codes
