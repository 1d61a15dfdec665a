"""A range solved again solves its fingers as well: from what is measured, through pins, and nothing beside it moves."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.fitters.keyframes.frame_range import FrameRange, Pin
from solver_backend.fitters.pipeline import resolve_range, solve
from solver_backend.types import Capture, Motion
from tests.support.handed_take import handed_take
from tests.support.short_solves import QUICK

FRAMES, FIRST, LAST, PINNED = 20, 5, 15, 10
BODY = 21
"""Joints after the root that are no fingers."""
INDEX = 30  # First joint of the left ring finger among the joints after the root.


@lru_cache(maxsize=1)
def capture() -> Capture:
    return handed_take(FRAMES, seed=2).capture


def without_hands() -> Capture:
    keypoints = capture().keypoints
    assert keypoints is not None
    return replace(capture(), keypoints=replace(keypoints, hands=None))


@lru_cache(maxsize=1)
def solved() -> Motion:
    return solve(capture(), QUICK).motion


def fingers(motion: Motion) -> np.ndarray:
    """Return (F, 30, 3) axis-angles."""
    return motion.body_pose.reshape(FRAMES, -1, 3)[:, BODY:]


def pin(motion: Motion) -> Pin:
    pose = motion.body_pose[PINNED].copy().reshape(-1, 3)
    pose[INDEX] += [0.3, 0.0, 0.0]
    return Pin(PINNED, motion.global_orient[PINNED], pose.ravel(), motion.transl[PINNED])


@pytest.mark.slow
def test_fingers_that_were_wrong_come_from_the_views_again() -> None:
    wrong = solved().body_pose.copy().reshape(FRAMES, -1, 3)
    wrong[FIRST + 1 : LAST, BODY:] = 0.0
    spoiled = replace(solved(), body_pose=wrong.reshape(FRAMES, -1))
    again = resolve_range(capture(), spoiled, FrameRange(FIRST, LAST), QUICK).motion
    assert again.body_layout.joints == SMPL_HANDS.joints
    inside = slice(FIRST + 1, LAST)
    was, now = (np.abs(fingers(m)[inside] - fingers(solved())[inside]).mean() for m in (spoiled, again))
    assert now < 0.25 * was
    outside = np.r_[: FIRST + 1, LAST:FRAMES]
    for name in ("body_pose", "global_orient", "transl"):
        np.testing.assert_array_equal(getattr(again, name)[outside], getattr(spoiled, name)[outside])
    assert again.joints is not None and solved().joints is not None
    tips = np.linalg.norm(again.joints[inside, 22:] - solved().joints[inside, 22:], axis=-1)
    assert np.median(tips) < 0.01


@pytest.mark.slow
def test_fingers_pass_through_the_pinned_ones() -> None:
    wanted = pin(solved())
    again = resolve_range(capture(), solved(), FrameRange(FIRST, LAST, (wanted,)), QUICK).motion
    np.testing.assert_allclose(fingers(again)[PINNED], wanted.body_pose.reshape(-1, 3)[BODY:], atol=1e-12)
    steps = np.abs(np.diff(fingers(again)[FIRST : LAST + 1, INDEX - BODY], axis=0)).max()
    assert steps < 0.2
    np.testing.assert_array_equal(fingers(again)[: FIRST + 1], fingers(solved())[: FIRST + 1])


@pytest.mark.slow
def test_fingers_that_no_view_shows_there_are_less_sure() -> None:
    keypoints = capture().keypoints
    assert keypoints is not None and keypoints.hands is not None
    hidden = keypoints.hands.copy()
    hidden[:, FIRST : LAST + 1, 0] = np.nan
    blind = replace(capture(), keypoints=replace(keypoints, hands=hidden))
    sigma = resolve_range(blind, solved(), FrameRange(FIRST, LAST), QUICK).motion.joint_sigma
    assert sigma is not None
    left, right = (np.median(sigma[PINNED, list(SMPL_HANDS.group(f"{side}_hand"))]) for side in ("left", "right"))
    assert left > 1.5 * right


@pytest.mark.slow
def test_without_hands_what_a_pin_changes_fades() -> None:
    motion, wanted = solved(), pin(solved())
    again = resolve_range(without_hands(), motion, FrameRange(FIRST, LAST, (wanted,)), QUICK).motion
    assert again.body_layout.joints == SMPL_HANDS.joints
    before, after = (fingers(m) for m in (motion, again))
    np.testing.assert_array_equal(before[: FIRST + 1], after[: FIRST + 1])
    np.testing.assert_array_equal(before[LAST:], after[LAST:])
    np.testing.assert_allclose(after[PINNED], wanted.body_pose.reshape(-1, 3)[BODY:], atol=1e-12)
    faded = np.diff((after - before)[FIRST : PINNED + 1, INDEX - BODY, 0])
    np.testing.assert_allclose(faded, 0.3 / (PINNED - FIRST), atol=1e-9)
