"""How restlessly a prop moves, time by time: what its motion's noise of acceleration is."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.props.prop_start import PropStart
from solver_backend.fitters.props.prop_state import turns

LAG_S = 0.1
"""Over so long are accelerations measured: gaps are about as long, and markers' noise hardly counts."""
AROUND_S = 1.0
"""Over so long is unrest averaged."""
USUAL_S = 0.1
"""Seconds of the take's average that are counted with what is measured near by; in a gap they are all there is."""
LEAST_SHARE, LEAST_M, LEAST_RAD = 0.02, 2e-4, 2e-3
"""Of the take's unrest that every stretch has at least; and what a prop at rest strays by in ``LAG_S``."""


def unrest_of(start: PropStart, fps: float) -> np.ndarray:
    """Return (F - 1, 2) power densities of the angular acceleration (rad²/s³) and of the acceleration (m²/s³).

    The change of displacement over two spans of length h has the variance ``⅔ q h³`` per axis where acceleration is
    white noise of density q.

    Args:
        start: poses of frames.
        fps: frames per second.
    """
    frames = len(start.t)
    lag = max(1, min(round(LAG_S * fps), (frames - 1) // 2))
    span, middle = lag / fps, slice(lag, frames - lag)
    known = start.posed[: frames - 2 * lag] & start.posed[middle] & start.posed[2 * lag :]
    R, t = start.R, start.t
    second = turns(R[middle], R[2 * lag :]) - turns(R[: frames - 2 * lag], R[middle])
    bend = t[2 * lag :] - 2 * t[middle] + t[: frames - 2 * lag]
    square = np.stack([(second**2).mean(-1), (bend**2).mean(-1)], axis=1)
    usual = square[known].mean(axis=0) if known.any() else np.zeros(2)
    width = max(1, round(AROUND_S * fps))
    count, total = _around(known, width), np.stack([_around(square[:, k] * known, width) for k in range(2)], axis=1)
    prior = max(1.0, USUAL_S * fps)
    local = (total + prior * usual) / (count + prior)[:, None]
    least = np.maximum(LEAST_SHARE * usual, np.square([LEAST_RAD, LEAST_M]))
    density = np.maximum(local, least) * 1.5 / span**3
    return density[np.clip(np.arange(frames - 1) - lag, 0, len(density) - 1)]


def _around(values: np.ndarray, width: int) -> np.ndarray:
    """Return the sums of the values around each, a whole width of them; fewer at the ends."""
    sums = np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])
    at = np.arange(len(values))
    return sums[np.minimum(at + width // 2 + 1, len(values))] - sums[np.maximum(at - width // 2, 0)]
