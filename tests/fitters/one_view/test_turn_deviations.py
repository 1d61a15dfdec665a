"""One camera's segments turn by as much as the lifter is unsure of their ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.biomechanics.segments import SEGMENTS, segment_turns, turn_spread
from solver_backend.body.body import load_body
from solver_backend.fitters.one_view.depth import TURNS, with_open_depth
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import unpacked
from tests.fitters.one_view.test_steady_depth import one_view, solved

SHIN = list(SEGMENTS).index("left_shank")


def test_turns_are_as_unsure_as_the_ends_of_their_bones() -> None:
    body, take, one = load_body(), solved(0.0), one_view()
    frames, joints = len(one.sight), np.asarray(body.recorded_joints)
    unsure = one.sight_sigma_m.copy()
    unsure[: frames // 2] *= 2.0
    zero = np.zeros((frames, len(joints), 6))
    turns = np.full((frames, len(SEGMENTS), 6), [1e-4, 0, 0, 1e-4, 0, 1e-4])
    wide = with_open_depth(replace(take, covariance=zero, turns=turns), replace(one, sight_sigma_m=unsure), joints)
    variance = np.trace(unpacked(np.asarray(wide.turns)), axis1=-2, axis2=-1)[:, SHIN] / 3.0 - 1e-4
    rest = body.joints_template
    length = np.linalg.norm(rest[7] - rest[4])
    assert np.allclose(np.sqrt(variance[-1]), TURNS["shank"] * np.hypot(0.1, 0.1) / length, rtol=1e-6)
    assert np.allclose(variance[0], 4.0 * variance[-1])


def test_a_segment_turns_by_the_joints_between_it_and_the_one_above() -> None:
    body = load_body()
    local = np.tile(np.eye(3), (1, 21, 1, 1))
    bends = [exp_so3(np.array([0.1 * k, 0.0, 0.0])) for k in (1, 2, 3)]
    for joint, bend in zip((3, 6, 9), bends, strict=True):  # the spine, from the pelvis to the thorax
        local[0, joint - 1] = bend
    turns = segment_turns(body, np.eye(3)[None], local)[0]
    assert np.allclose(turns[list(SEGMENTS).index("thorax")], exp_so3(np.array([0.6, 0.0, 0.0])))
    assert np.allclose(turns[SHIN], np.eye(3))
    assert turn_spread(body, np.ones((2, len(body.recorded_joints)))).shape == (2, len(SEGMENTS))
