"""The figures of reconstructions against known errors."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from training.engine.accuracy import reconstruction_statistics


def test_statistics_find_the_spread() -> None:
    rng = np.random.default_rng(0)
    decoded = exp_so3(0.5 * rng.standard_normal((4000, 21, 3)))
    sigma = np.radians(rng.uniform(1, 8, (21, 3)))
    truth = exp_so3(sigma * rng.standard_normal((4000, 21, 3))) @ decoded
    np.testing.assert_allclose(reconstruction_statistics(truth, decoded), sigma, rtol=0.08)
