"""Contacts that the user adds or removes, in a solve of a range."""

from __future__ import annotations

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, film_benchmark
from solver_backend.exchange.contact_parts import CONTACT_PARTS
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.fitters.keyframes.frame_range import FrameRange, UserContact
from solver_backend.fitters.pipeline import resolve_range, solve
from tests.support.floor_takes import FPS, kneeling


@pytest.mark.slow
def test_a_range_solved_again_follows_the_contacts_of_the_user() -> None:
    person, knee = kneeling(90), list(CONTACT_PARTS).index("left_knee")
    capture = film_benchmark(person, FPS, "kneeling", BenchmarkSettings(seed=3), np.random.default_rng(3))
    first = solve(capture).motion
    assert first.touches is not None and first.touches[:, knee].all()
    removed = FrameRange(20, 60, contacts=(UserContact("left_knee", 30, 45, False),))
    again = resolve_range(capture, first, removed).motion
    assert again.touches is not None and not again.touches[30:46, knee].any() and again.touches[:30, knee].all()
    np.testing.assert_array_equal(again.transl[:20], first.transl[:20])
    later = resolve_range(capture, again, FrameRange(25, 55)).motion  # which remembers the contact
    assert later.touches is not None and not later.touches[30:46, knee].any()


@pytest.mark.slow
def test_an_added_contact_pulls_a_hand_down() -> None:
    person, hand = kneeling(90), list(CONTACT_PARTS).index("left_hand")
    capture = film_benchmark(person, FPS, "kneeling", BenchmarkSettings(seed=3), np.random.default_rng(3))
    first, wrist = solve(capture).motion, SMPL_JOINTS.index("left_wrist")
    added = FrameRange(20, 60, contacts=(UserContact("left_hand", 30, 45, True),))
    again = resolve_range(capture, first, added).motion
    assert again.touches is not None and again.touches[30:46, hand].all() and not again.touches[:30, hand].any()
    assert again.joints[38, wrist, 2] < first.joints[38, wrist, 2] - 0.05
