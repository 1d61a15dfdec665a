"""How close keys stand and which passes are made, by how fast a person in markers moves."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.initial_keys import closer_window, paces
from solver_backend.fitters.measurements.markers import assign_person, known_markers_of, measure_markers
from solver_backend.fitters.model.subject import FrameStates, Subject
from solver_backend.fitters.problem import Problem, RoughMotion
from solver_backend.fitters.recipes import bundle
from solver_backend.fitters.recipes.bundle import CLOSEST, FIXED_CODES, ON_THE_MANIFOLD, PassPlan, plan_known_person
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthesis.embedded.demo import record_markers

ROUGH = RoughMotion(np.arange(1), FrameStates(np.zeros((1, 32)), np.eye(3)[None], np.zeros((1, 3))))


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0, 100.0, 120.0, 250.0])
def test_how_fast_points_are_does_not_depend_on_the_rate(fps: float) -> None:
    """A circle of 10 cm at 2 turns a second: ``r ω²``, less what a chord of two keys' spacing takes off."""
    time = np.arange(0, 4, 1 / fps)[:, None] * np.ones(5)
    angle, apart = 2 * np.pi * 2 * time, max(1, round(fps / 12))
    points = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    h = apart / fps
    expected = 0.2 * (1 - np.cos(4 * np.pi * h)) / h**2
    assert paces(points, fps, apart) == pytest.approx((expected, expected), rel=1e-6)
    points[::3, 2] = np.nan
    assert paces(points, fps, apart)[0] == pytest.approx(expected, rel=1e-6)


def test_noise_of_markers_brings_keys_no_closer() -> None:
    noise = 0.004 * np.random.default_rng(1).normal(size=(600, 41, 3))
    assert paces(noise, 60.0, 5)[0] < 2.5 and closer_window(10, paces(noise, 60.0, 5)[0], 4.0, CLOSEST) == 10
    assert paces(np.full((30, 4, 3), np.nan), 60.0, 5) == (0.0, 0.0)
    assert paces(np.zeros((3, 4, 3)), 60.0, 5) == (0.0, 0.0)


def test_fast_takes_have_closer_keys_and_a_calm_one_starts_near() -> None:
    body, take = load_body(), record_markers(120, 60.0, seed=3).cloud
    measured = measure_markers(known_markers_of(take), body, np.zeros(1))
    measured = replace(measured, known_person=Subject.average(body, measured.landmarks, np.zeros(1)), rough=ROUGH)

    def plan(fps: float, rough: RoughMotion | None = ROUGH) -> PassPlan:
        """Of the same take, recorded in slow or in fast motion: accelerations grow with the square."""
        problem = Problem.of(body, load_sposer(), replace(measured, fps=fps, rough=rough))
        return plan_known_person(problem, SolveSettings())

    slow, usual, fast = plan(24.0), plan(60.0), plan(240.0)
    assert len(slow.passes) == 1 and len(plan(24.0, rough=None).passes) == 2
    assert len(fast.passes) == 2
    assert (slow.window, usual.window) == (4, 10)
    assert CLOSEST * 40 <= fast.window < 20 and fast.passes[-1].schedule.stride == round(0.2 * fast.window)


@pytest.mark.parametrize("marker_sigma", [None, 0.008])
@pytest.mark.parametrize("residuals", [False, True])
def test_outlier_markers_draw_again_where_the_person_was_calibrated_and_nowhere_else(
    marker_sigma: float | None, residuals: bool
) -> None:
    """A motion's own keypoints, which a clean-up solves, belong to no marker that could lie on a bent hand."""
    body, take = load_body(), record_markers(12, 30.0, seed=3).cloud
    measured = measure_markers(known_markers_of(take), body, np.zeros(1))
    subject = Subject.average(body, measured.landmarks, np.zeros(1))
    if marker_sigma is None:
        measured = replace(measured, known_person=subject)
    else:
        measured = assign_person(measured, subject, np.full(len(measured.landmarks.names), marker_sigma))
    problem = Problem.of(body, load_sposer(), measured)
    plan = plan_known_person(problem, SolveSettings(residual_rotations=residuals))
    found = [step.func for step in plan.after if isinstance(step, partial)]
    assert found == ([bundle.restart_outlier_markers] if residuals and marker_sigma is not None else [])
    assert plan.passes[-1].free == (FIXED_CODES if residuals else ON_THE_MANIFOLD)
