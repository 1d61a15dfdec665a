"""Fingers keep out of one another: how deep they overlap, what pushes them apart, and what is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.hand_skeleton import (
    FINGER_OF,
    JOINT_OF,
    KIND_OF,
    PALM_M,
    RADIUS_M,
    SPREAD,
    finger_gaps,
    finger_overlap,
    nearest_points,
)
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.solve_hand import (
    HandKeys,
    HandProblem,
    KeyModel,
    SolvedHand,
    contact_equations,
    frame_states,
    solve_hand,
    solve_keys,
    untangled,
)
from solver_backend.fitters.hands.solve_hands import through_fingers
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.residuals.positions import PositionTerm
from tests.support.moving_hand import drawn_states, hand_problem
from tests.support.open_hand import open_hand

SPREAD_OF = {int(FINGER_OF[a]): int(a) for a in np.flatnonzero((KIND_OF == SPREAD) & (JOINT_OF == 0))}
"""The angle by which each finger leans, of ``ANGLES``."""
RNG = np.random.default_rng(4)


def test_segments_are_as_near_as_a_fine_search_finds() -> None:
    a, b, c, d = RNG.normal(size=(4, 40, 3))
    along, apart = nearest_points(a, b, c, d)
    steps = np.linspace(0, 1, 201)
    one = a[:, None] + steps[:, None] * (b - a)[:, None]
    other = c[:, None] + steps[:, None] * (d - c)[:, None]
    searched = np.linalg.norm(one[:, :, None] - other[:, None], axis=-1).min(axis=(1, 2))
    np.testing.assert_allclose(np.linalg.norm(apart, axis=-1), searched, atol=0.02)
    assert ((along >= 0) & (along <= 1)).all()


def test_an_open_hand_overlaps_nowhere_and_a_finger_laid_over_another_by_both_radii() -> None:
    points = open_hand(1)[None]
    assert finger_overlap(points)[0] == 0.0
    crossed = points.copy()
    crossed[:, 9:13] = crossed[:, 5:9]
    palm = np.linalg.norm(crossed[0, 9] - crossed[0, 0])
    assert finger_overlap(crossed)[0] == pytest.approx((RADIUS_M[1] + RADIUS_M[2]) * palm / PALM_M)
    assert finger_gaps(points).depth.max() < 0


def pressed(seed: int) -> tuple[HandProblem, np.ndarray]:
    """Return a hand, and states in which the middle finger leans through the ring finger."""
    problem, _ = hand_problem(24, seed)
    states = drawn_states(24, seed)
    for lean in np.linspace(0.0, 1.2, 25):
        states[:, 6:] = problem.prior.mean
        states[:, 6 + SPREAD_OF[2]] += lean
        if (finger_overlap(problem.points(states)) > 0.006).all():
            return problem, states
    raise AssertionError("no such lean")


def test_the_gradient_is_the_costs_derivative() -> None:
    problem, states = pressed(0)
    frames, step = np.arange(24), 1e-6
    cost, gradient, hessian = contact_equations(problem.points(states), problem.jacobian(states))
    assert (cost > 0).all()
    assert np.linalg.eigvalsh(hessian).min() > -1e-6 * np.abs(hessian).max()
    for column in range(6, states.shape[1]):
        moved = [states + sign * step * np.eye(states.shape[1])[column] for sign in (-1, 1)]
        costs = [contact_equations(problem.points(x), problem.jacobian(x))[0] for x in moved]
        np.testing.assert_allclose(
            (costs[1] - costs[0])[frames] / (2 * step), gradient[:, column], atol=2e-3 * np.abs(gradient).max()
        )


def test_a_solve_keeps_fingers_apart_that_noisy_points_press_together() -> None:
    problem, states = pressed(1)
    truth = problem.points(states)
    term = PositionTerm(truth, np.full(truth.shape[:2], 1.0 / 0.008**2))
    deep = {}
    for apart in (False, True):
        solved = solve_hand(replace(problem, term=term, keeps_apart=apart), truth, SolveSettings())
        deep[apart] = finger_overlap(solved.points)
        assert bool(through_fingers(solved, 1)) == bool((deep[apart] > 0.006).sum() >= 3)
    assert np.median(deep[False]) > 0.0042
    assert np.median(deep[True]) < 0.0035


def tangled(moving: np.ndarray | None = None) -> tuple[KeyModel, HandKeys]:
    """Return keys whose fingers run through one another where nothing is measured."""
    problem, states = pressed(1)
    relaxed = states.copy()
    relaxed[:, 6:] = problem.prior.mean
    weight = np.zeros((24, 21))
    weight[:6], weight[18:] = 1e5, 1e5
    term = PositionTerm(problem.points(relaxed), weight)
    model = KeyModel(replace(problem, term=term, keeps_apart=True), KeyframeLayout.even(24, 6), moving)
    keys = states[np.round(model.layout.key_times).astype(int)]
    return model, HandKeys(keys, 0.0, solve_keys(model, keys, (3.0,), 1, lambda: None).convergence)


def test_fingers_that_passed_through_one_another_are_solved_again_from_relaxed_ones() -> None:
    model, found = tangled()
    again = untangled(model, found, 3.0, 20, lambda: None)
    deep = [finger_overlap(model.problem.points(frame_states(model, keys))).max() for keys in (found.keys, again.keys)]
    assert deep[0] > 0.006 > deep[1]
    assert untangled(model, again, 3.0, 20, lambda: None) is again
    model, found = tangled(np.zeros(len(found.keys), bool))
    np.testing.assert_array_equal(untangled(model, found, 3.0, 20, lambda: None).keys, found.keys)


def test_fingers_that_run_through_one_another_are_named_with_their_frames() -> None:
    problem, states = pressed(2)
    solved = solve_hand(replace(problem, term=PositionTerm(problem.points(states), np.full((24, 21), 1e6))),
                        problem.points(states), SolveSettings())  # fmt: skip
    assert isinstance(solved, SolvedHand)
    (found,) = through_fingers(solved, 1)
    assert found.code == "fingers_through_fingers"
    assert found.where.joints == ("right_hand",)
    assert found.where.frames[0][0] <= 2
    assert through_fingers(replace(solved, informed=np.zeros_like(solved.informed)), 1) == ()
