"""Contacts, balance and flights of poses with known support."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.biomechanics.support import find_support
from solver_backend.body.body import load_body
from solver_backend.body.mesh import pose_mesh
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types import Motion
from tests.support.still_pose import still


def on_the_floor(motion: Motion) -> Motion:
    """Return the motion with the lowest skin of its first frame at z = 0."""
    local = exp_so3(motion.body_pose.reshape(motion.num_frames, 23, 3)[:1, :21])
    skin = pose_mesh(load_body(), motion.betas, exp_so3(motion.global_orient[:1]), local, motion.transl[:1])
    return replace(motion, transl=motion.transl - [0.0, 0.0, skin[..., 2].min()])


def test_a_standing_body_is_balanced_on_its_feet():
    support = find_support(on_the_floor(still(5)), load_body())
    touching = {part for part, chance in support.probability.items() if (chance > 0.5).all()}
    assert touching == {"left foot", "right foot"} and support.depth_m.max() < 1e-6
    assert support.margin_m.min() > 0.02 and support.margin_m.max() < 0.12 and not support.is_floating
    assert support.centre[0, 2] == pytest.approx(0.55 * load_body().stature_m, rel=0.06)  # Winter 2009, table 4.1


def test_a_leaning_body_is_not():
    motion = still(5)
    leaned = exp_so3(np.array([[np.radians(30.0), 0.0, 0.0]])) @ exp_so3(motion.global_orient)
    support = find_support(on_the_floor(replace(motion, global_orient=log_so3(leaned))), load_body())
    assert support.margin_m.max() < -0.1


def test_a_lying_body_touches_with_its_back_and_seat():
    motion = still(5)
    down = exp_so3(np.array([[np.radians(-90.0), 0.0, 0.0]])) @ exp_so3(motion.global_orient)
    support = find_support(on_the_floor(replace(motion, global_orient=log_so3(down))), load_body())
    touching = {part for part, chance in support.probability.items() if (chance > 0.5).all()}
    assert "seat" in touching or "back" in touching
    assert "left hand or forearm" not in touching or support.margin_m.min() > 0.0


def test_depth_and_flights_are_measured():
    motion = replace(on_the_floor(still(40)), fps=10.0)
    sunk = find_support(replace(motion, transl=motion.transl - [0.0, 0.0, 0.03]), load_body())
    assert sunk.depth_m == pytest.approx(0.03)
    up = motion.transl.copy()
    up[10:23, 2] += 0.3
    floating = find_support(replace(motion, transl=up), load_body())
    assert floating.longest_flight_s == pytest.approx(1.3) and floating.is_floating
    up[14:, 2] = motion.transl[14:, 2]
    assert not find_support(replace(motion, transl=up), load_body()).is_floating


@pytest.mark.parametrize("seconds", [3, 180])
def test_contacts_and_flights_do_not_depend_on_the_length_of_the_take(seconds):
    motion = on_the_floor(still(20 * seconds))
    share = np.arange(motion.num_frames) / 20.0 % 1.07  # 0.6 s of stance, 0.47 s of swing.
    place = np.zeros((motion.num_frames, 3))
    place[:, 0] = np.cumsum(np.where(share < 0.6, 0.0, 3.0 / 20.0))
    place[30:38, 2] = 0.3  # One jump of 0.4 s.
    walks = replace(motion, fps=20.0, transl=motion.transl + place, joints=motion.joints + place[:, None])
    support = find_support(walks, load_body())
    assert 0.4 < (support.probability["left foot"] > 0.5).mean() < 0.7
    assert support.longest_flight_s == pytest.approx(0.4, abs=0.03) and not support.is_floating


def test_a_moving_foot_does_not_touch_and_another_floor_is_unknown():
    motion = on_the_floor(still(20))
    slid = replace(motion, transl=motion.transl + np.linspace(0, 0.4, 20)[:, None] * [1.0, 0.0, 0.0])
    support = find_support(slid, load_body())
    assert max(chance.max() for chance in support.probability.values()) < 0.5 and np.isnan(support.margin_m).all()
    assert find_support(replace(motion, transl=motion.transl + [0.0, 0.0, 0.5]), load_body()) is None
