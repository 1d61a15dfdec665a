"""The minimiser over robust scales: it ends where the last scale ends, and it can be stopped."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.residuals.terms import geman_mcclure
from solver_backend.solver.levenberg_marquardt import DenseBlocks, LMSettings, minimise


class Place:
    """A number that most of the measurements agree on."""

    measured = np.array([1.0, 1.1, 0.9, 1.0, 9.0, 9.5])

    def linearise(self, state: np.ndarray, scale: float) -> tuple[np.ndarray, DenseBlocks]:
        error = state - self.measured
        cost, weight = geman_mcclure(error**2, scale)
        H, g = weight.sum()[None, None, None], (weight * error).sum()[None, None]
        return 0.5 * cost.sum()[None], DenseBlocks(H, g)

    def retract(self, state: np.ndarray, step: np.ndarray) -> np.ndarray:
        return state + step[0, 0]


def test_outliers_that_draw_at_wide_scales_draw_no_longer_at_the_last() -> None:
    settings, ended = LMSettings(50, 1e-10), list[tuple[int, int]]()
    stages = [(scale, settings) for scale in (100.0, 3.0, 0.5)]
    found = minimise(Place(), np.array(5.0), stages, done=lambda number, total: ended.append((number, total)))
    assert found.converged and found.state == pytest.approx(1.0, abs=0.02)
    assert ended == [(1, 3), (2, 3), (3, 3)]
    wide = minimise(Place(), np.array(5.0), stages[:1])
    assert wide.state > 3.0


def test_whoever_is_asked_before_each_linearisation_can_end_it() -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        minimise(Place(), np.array(5.0), [(1.0, LMSettings())], stop)
