"""The equations of a calibration against finite differences of its cost."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_layout
from solver_backend.fitters import SolveSettings
from solver_backend.fitters.marker_calibration.calibrate import calibration_equations, person_state, placement_prior
from solver_backend.fitters.measurements.markers import measure_markers
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.person_shape import PersonState
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.single_frame import fit_to_points
from solver_backend.priors.sposer import load_sposer
from tests.support.worn_markers import worn_markers

LABELS = marker_layout("CMU_41")
SCALE = 8.0


@pytest.fixture(scope="module")
def at():
    """Return the cost of a step away from a state that is not solved, and the gradient there."""
    body, prior = load_body(), load_sposer()
    cloud = worn_markers(LABELS, 3, step=20).cloud
    problem = Problem.of(body, prior, measure_markers(cloud, body, np.zeros(1)))
    subject = Subject.average(body, problem.measurements.landmarks, np.zeros(1))
    frames = np.arange(3)
    start = person_state(subject, problem.prior, fit_to_points(problem, subject, frames))
    placement = placement_prior(subject, SolveSettings())
    rng = np.random.default_rng(3)
    size = 10 + 3 * len(LABELS) + 99 * len(frames)
    start = start.retract(0.01 * rng.normal(size=(1, size)))

    def evaluate(state: PersonState):
        return calibration_equations(prior, problem.objective.select(frames), placement, state, SCALE)

    return start, evaluate, size


def test_the_gradient_is_that_of_the_cost(at):
    state, evaluate, size = at
    _, system = evaluate(state)
    gradient = np.concatenate([system.g_shared, system.g_blocks.reshape(-1)])
    rng, step = np.random.default_rng(4), 1e-5
    shared = 10 + 3 * len(LABELS)
    for part in (slice(0, 10), slice(10, shared), slice(shared, size)):
        direction = np.zeros(size)
        direction[part] = rng.normal(size=len(direction[part]))
        ahead, behind = (evaluate(state.retract(sign * step * direction[None]))[0][0] for sign in (1, -1))
        measured = (ahead - behind) / (2 * step)
        assert measured == pytest.approx(gradient @ direction, rel=2e-3, abs=1.0)


def test_a_step_with_poses_eliminated_solves_the_whole_system(at):
    state, evaluate, size = at
    _, system = evaluate(state)
    m, n = system.coupling.shape[2], system.coupling.shape[1]
    whole = np.zeros((size, size))
    whole[:m, :m] = system.shared
    for f in range(len(system.blocks)):
        rows = slice(m + n * f, m + n * (f + 1))
        whole[rows, rows] = system.blocks[f]
        whole[rows, :m], whole[:m, rows] = system.coupling[f], system.coupling[f].T
    np.testing.assert_allclose(whole, whole.T, rtol=1e-6, atol=1e-4)
    gradient = np.concatenate([system.g_shared, system.g_blocks.reshape(-1)])
    step = system.solve(np.zeros(1))[0]
    np.testing.assert_allclose(whole @ step, -gradient, rtol=1e-4, atol=1e-3 * np.abs(gradient).max())
