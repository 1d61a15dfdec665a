"""Three equations by Cramer's rule against LAPACK."""

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import solved_3x3


def test_blended_rotations_are_solved_as_lapack_does():
    rng = np.random.default_rng(2)
    A = 0.6 * exp_so3(rng.normal(size=(40, 5, 3))) + 0.4 * exp_so3(0.5 * rng.normal(size=(40, 5, 3)))
    b = rng.normal(size=(40, 5, 3))
    b[3, 2] = np.nan
    good = np.linalg.cond(A) < 1e3
    np.testing.assert_allclose(solved_3x3(A, b)[good], np.linalg.solve(A, b[..., None])[..., 0][good], rtol=1e-9)
    assert np.isnan(solved_3x3(A, b)[3, 2]).all() and np.isnan(solved_3x3(A, b)).sum() == 3
