"""The keys of a hand: Levenberg-Marquardt over robust scales from wide to narrow, and how sure they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.hands.hand_keys import covariance_at
from solver_backend.fitters.hands.hand_problem import KeyModel
from solver_backend.fitters.model.control_points import spline_states
from solver_backend.fitters.solution import Convergence
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt
from solver_backend.types.shapes import Float

NEAR, DONE = 1e-2, 1e-3
"""Shares of the cost by which a step must lower it to go on, at wide scales and at the last."""


@dataclass(frozen=True)
class HandKeys:
    """Solved keys of a hand."""

    keys: Float[np.ndarray, "keys d"]
    """(K, D)."""
    cost: float
    """At the last robust scale."""
    convergence: Convergence
    """How that ended."""


def solve_keys(
    model: KeyModel, keys: np.ndarray, scales: Sequence[float], iterations: int, alive: Callable[[], None]
) -> HandKeys:
    """Return the keys that minimise the model, solved at each robust scale from where the one before ended.

    Args:
        model: the keys' objective.
        keys: (K, D) where to start.
        scales: Geman-McClure scales in standard deviations.
        iterations: linearisations at most, per scale.
        alive: called before each linearisation.
    """
    result = None
    for scale in scales:

        def linearise(x: np.ndarray, scale: float = scale):
            alive()
            return model.linearise(x, scale)

        tolerance = NEAR if scale > scales[-1] else DONE
        settings = LMSettings(max_iterations=iterations, tolerance=tolerance, promise=1.0)
        result = levenberg_marquardt(keys, linearise, _moved, settings)
        keys = result.state
    assert result is not None
    return HandKeys(keys, float(result.cost[0]), Convergence.of(result))


def frame_states(model: KeyModel, keys: np.ndarray) -> Float[np.ndarray, "frames d"]:
    """Return (F, D) states of all frames, on the spline whose velocities and accelerations are continuous."""
    return spline_states(keys, model.layout)


def frame_covariances(model: KeyModel, keys: np.ndarray, scale: float) -> Float[np.ndarray, "frames d d"]:
    """Return (F, D, D) covariances of the states of all frames."""
    system = model.linearise(keys, scale)[1]
    found, rows = covariance_at(system, model.layout)
    covariance = np.zeros((model.problem.num_frames, *found.shape[1:]))
    covariance[rows.frames.reshape(-1)] = found
    return covariance


def _moved(keys: np.ndarray, step: np.ndarray) -> np.ndarray:
    return keys + step.reshape(-1, keys.shape[1])[: len(keys)]
