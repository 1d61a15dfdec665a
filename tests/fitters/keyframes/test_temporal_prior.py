"""The priors on keyframes: gradient against central differences, Hessian against J J for the linear parts."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.state_layout import TRANSL
from solver_backend.fitters.keyframes.normal_equations import (
    FADING_S,
    KeyframeNormalEquations,
    MotionPrior,
    ResidualRotationTerm,
)
from tests.support.key_equations import dense, no_equations
from tests.support.layouts import LAYOUTS, ON_MANIFOLD, WHOLE
from tests.support.random_keys import random_keys

KEYS = 7


@pytest.mark.parametrize("unseen", [None, np.array([False, False, True, True, True, False])])
@pytest.mark.parametrize("residuals", [False, True])
def test_gradient_equals_central_differences(residuals, unseen):
    keys, layout = random_keys(KEYS), LAYOUTS[residuals]
    dof = layout.dof
    terms = [MotionPrior(0.2, 2.0, 3.0, 4.0, unseen), *[ResidualRotationTerm(np.full((21, 3), 0.1), 1.0)] * residuals]
    equations = no_equations(layout, KEYS)
    for term in terms:
        term.add_to(equations, keys)
    gradient = equations.g.reshape(-1)[: KEYS * dof]
    rng = np.random.default_rng(0)
    for _ in range(5):
        direction = rng.normal(size=(KEYS, dof))
        costs = [
            sum(term.cost(keys.retract(s * 1e-5 * direction, layout), layout).sum() for term in terms) for s in (1, -1)
        ]
        numeric = (costs[0] - costs[1]) / 2e-5
        assert gradient @ direction.reshape(-1) == pytest.approx(numeric, rel=1e-6)


def test_hessian_is_symmetric_positive_and_exact_for_translations():
    keys = random_keys(KEYS)
    prior = MotionPrior(0.2, accel_sigma=2.0, angular_sigma=1e9, latent_sigma=1e9)
    equations = no_equations(ON_MANIFOLD, KEYS)
    prior.add_to(equations, keys)
    full = dense(equations)[: KEYS * 36, : KEYS * 36]
    np.testing.assert_allclose(full, full.T, atol=1e-12)
    assert np.linalg.eigvalsh(full).min() > -1e-8
    second = np.zeros((KEYS - 2, KEYS))
    for k in range(KEYS - 2):
        second[k, k : k + 3] = [1, -2, 1]
    expected, height = second.T @ second / (2.0 * 0.2**2) ** 2, WHOLE[TRANSL].start
    np.testing.assert_allclose(full[height::36, height::36], expected, rtol=1e-6, atol=1e-9)


def test_between_unseen_keys_speed_fades():
    """A body that goes at 1 m/s when it is last seen goes on for about the way of ``FADING_S``."""
    spacing, count = 0.05, 41
    keys = replace(random_keys(count), transl=np.zeros((count, 3)))
    prior = MotionPrior(spacing, unseen=np.ones(count - 1, dtype=bool))
    blocks = (count + 1) // 2
    equations = KeyframeNormalEquations(
        np.zeros((blocks, 72, 72)), np.zeros((blocks - 1, 72, 72)), np.zeros((blocks, 72)), ON_MANIFOLD
    )
    prior.add_to(equations, keys)
    along_x = np.arange(count) * 36 + WHOLE[TRANSL].start
    H = dense(equations)[np.ix_(along_x, along_x)]
    start = np.array([0.0, spacing])
    path = np.append(start, np.linalg.solve(H[2:, 2:], -H[2:, :2] @ start))
    speed = np.diff(path) / spacing
    assert path[-1] == pytest.approx(FADING_S + 0.5 * spacing, abs=0.01)
    assert speed[10] / speed[5] == pytest.approx(np.exp(-5 * spacing / FADING_S), rel=0.05)
