"""Keys of a hand: derivatives agree with differences, a known motion comes back, and what is unsure is known to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.hand_skeleton import FINGER_OF, JOINT_OF, KIND_OF
from solver_backend.fitters.hands.solve_hand import (
    DOF,
    FINGERS,
    HandProblem,
    KeyModel,
    frame_covariances,
    frame_states,
    solve_keys,
)
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.residuals.positions import PositionTerm
from tests.support.moving_hand import hand_problem

RNG = np.random.default_rng(2)
MCP_AND_PIP = np.flatnonzero((FINGER_OF > 0) & (KIND_OF == 0) & (JOINT_OF < 2))


def model_of(problem: HandProblem, window: int = 6) -> KeyModel:
    return KeyModel(problem, KeyframeLayout.even(problem.num_frames, window))


def solved(model: KeyModel, start: np.ndarray | None = None) -> np.ndarray:
    keys = np.zeros((model.layout.num_keys, DOF)) if start is None else start
    keys[:, FINGERS] = model.problem.prior.mean
    return solve_keys(model, keys, (12.0, 6.0, 3.0), 20, lambda: None).keys


@pytest.mark.parametrize("frames", [6, 31])
def test_the_gradient_is_that_of_the_cost(frames: int) -> None:
    model = model_of(hand_problem(frames)[0])
    keys = RNG.normal(0, 0.2, (model.layout.num_keys, DOF))
    gradient, step = model.equations(keys, 3.0)[1].g.reshape(-1, DOF), 1e-6
    for k, d in zip(RNG.integers(0, len(keys), 25), RNG.integers(0, DOF, 25), strict=True):
        moved = [keys.copy(), keys.copy()]
        moved[0][k, d] -= step
        moved[1][k, d] += step
        slope = (model.equations(moved[1], 3.0)[0] - model.equations(moved[0], 3.0)[0]) / (2 * step)
        assert gradient[k, d] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def test_the_block_matrix_is_the_derivative_of_the_gradient_where_keys_stand_unevenly() -> None:
    """Without data all terms but the limits of joints are quadratic; solved in blocks as in one dense matrix."""
    problem = hand_problem(19)[0]
    blind = PositionTerm(np.zeros((19, *problem.sites.offset.shape)), np.zeros((19, len(problem.sites.offset))))
    model = KeyModel(replace(problem, term=blind), KeyframeLayout(np.array([0, 4, 11, 18])))
    keys = np.zeros((model.layout.num_keys, DOF))
    keys[:, FINGERS] = problem.prior.mean
    moved = RNG.normal(0, 1e-3, keys.shape)
    equations, after = (model.equations(at, 3.0)[1] for at in (keys, keys + moved))
    count = keys.size
    dense = np.zeros((len(equations.g), 2 * DOF, len(equations.g), 2 * DOF))
    for w, block in enumerate(equations.diagonal):
        dense[w, :, w] = block
    for w, block in enumerate(equations.upper):
        dense[w, :, w + 1], dense[w + 1, :, w] = block, block.T
    dense = dense.reshape(equations.g.size, -1)[:count, :count]
    change = (after.g - equations.g).reshape(-1)[:count]
    np.testing.assert_allclose(dense @ moved.reshape(-1), change, rtol=1e-5, atol=1e-4)
    step = after.block_tridiagonal().solve(np.zeros(1))[0, :count]
    np.testing.assert_allclose(dense @ step, -after.g.reshape(-1)[:count], rtol=1e-6, atol=1e-4)
    diagonal, _ = equations.block_tridiagonal().marginals()
    np.testing.assert_allclose(diagonal[0], np.linalg.inv(dense)[: 2 * DOF, : 2 * DOF], rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("side", [0, 1])
def test_a_known_motion_comes_back(side: int) -> None:
    problem, truth = hand_problem(60, seed=3, side=side)
    model = model_of(problem)
    states = frame_states(model, solved(model))
    error = np.rad2deg(states - truth)[:, FINGERS][:, MCP_AND_PIP]
    assert np.sqrt((error**2).mean()) < 5.0
    assert np.linalg.norm(problem.points(states) - problem.points(truth), axis=-1).mean() < 0.002


def test_ellipsoids_hold_the_share_that_they_name() -> None:
    found = []
    for seed in range(3):
        problem, truth = hand_problem(50, seed=seed + 20)
        model = model_of(problem)
        keys = solved(model)
        states, covariance = frame_states(model, keys), frame_covariances(model, keys, 3.0)
        J = problem.jacobian(states)
        spread = J @ covariance[:, None] @ np.swapaxes(J, -1, -2)
        error = problem.points(states) - problem.points(truth)
        found.append((error * np.linalg.solve(spread, error[..., None])[..., 0]).sum(-1) < 7.81)
    assert 0.85 < np.mean(found) < 1.0


def test_a_finger_that_nobody_sees_rests_and_is_unsure() -> None:
    problem, _ = hand_problem(40, seed=5)
    assert isinstance(problem.term, PositionTerm)
    weight = problem.term.weight.copy()
    weight[:, 17:] = 0.0
    hidden = replace(problem, term=replace(problem.term, weight=weight))
    model = model_of(hidden)
    keys = solved(model)
    covariance = frame_covariances(model, keys, 3.0)[:, FINGERS, FINGERS]
    sigma = np.rad2deg(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
    pinky = (FINGER_OF == 4) & (KIND_OF == 0)
    assert sigma[:, pinky].min() > 8.0
    assert sigma[:, MCP_AND_PIP[:4]].max() < 8.0
    angles = frame_states(model, keys)[:, FINGERS]
    prior = problem.prior
    assert (angles[:, pinky] > prior.low[pinky] - 0.1).all()
    assert (angles[:, pinky] < prior.high[pinky] + 0.1).all()


def test_one_wrong_point_moves_nothing_far() -> None:
    problem, _ = hand_problem(40, seed=6)
    assert isinstance(problem.term, PositionTerm)
    wrong = problem.term.positions.copy()
    wrong[10:30, 8] += [0.1, 0.1, 0.0]
    model, spoilt = model_of(problem), model_of(replace(problem, term=replace(problem.term, positions=wrong)))
    found = [frame_states(m, solved(m)) for m in (model, spoilt)]
    apart = np.linalg.norm(problem.points(found[0]) - problem.points(found[1]), axis=-1)
    others = [i for i in range(21) if i != 8]
    assert apart[:, others].max() < 0.008
    assert apart[:, 8].max() < 0.02


def test_no_joint_goes_far_beyond_its_range_in_any_frame() -> None:
    """Points that bend a finger backwards for a while, as a detector's do that takes a back for a palm."""
    problem, states = hand_problem(24)
    pip = FINGERS.start + int(np.flatnonzero((FINGER_OF == 1) & (JOINT_OF == 1))[0])
    states[8:14, pip] = problem.prior.low[pip - FINGERS.start] - np.deg2rad(45.0)
    bent = replace(problem, term=PositionTerm(problem.points(states), np.full((24, 21), 1.0 / 0.003**2)))
    model = model_of(bent)
    angles = frame_states(model, solved(model))[:, FINGERS]
    assert np.rad2deg(np.maximum(bent.prior.low - angles, angles - bent.prior.high)).max() < 1.5
