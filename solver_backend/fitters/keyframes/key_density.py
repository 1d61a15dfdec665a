"""How close keyframes stand: closer where people move faster."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.keyframes.optimise import BundleModel
from solver_backend.fitters.model.control_points import control_points
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.model.subject import points_of
from solver_backend.geometry.arrays import to_numpy
from solver_backend.types import Motion

CALM_M_S2 = 5.2
"""Mean acceleration of the landmarks up to which the settings' window holds; exercises and walking have 2 to 5."""
CLOSEST = 0.6
"""Of the settings' window at least; dances, at 15 m/s², reach it. Chosen by exact dances of
``bench floor``: salsa_07 falls from 4.93 to 2.93 mm."""


def dense_layout(
    model: BundleModel, layout: KeyframeLayout, keys: Keyframes, window: int, fps: float
) -> KeyframeLayout:
    """Return the windows for a take that moves as a first solution does: ``w max(0.6, min(1, √(5.2 / a)))`` frames.

    a is the mean acceleration of the landmarks in m/s². A parabola through three keys misses a fast limb by more than
    a detector does; through slow ones closer keys would let the detector's noise pass. What a is depends little on that
    noise: 15.1 and 15.4 m/s² in one dance seen exactly and with the measured noise, 4.3 and 4.8 in one walk.

    Args:
        model: what makes poses of the keys.
        layout: windows of the first solution, which is returned where they are close enough.
        keys: the first solution.
        window: frames of its windows.
        fps: frames per second.
    """
    frames = model.poses(control_points(keys, layout), layout, spline=True)
    points = to_numpy(points_of(model.subject, frames))
    acceleration = float(np.linalg.norm(np.diff(points, 2, axis=0), axis=-1).mean()) * fps**2
    closer = closer_window(window, acceleration, CALM_M_S2, CLOSEST)
    return layout if closer >= window else KeyframeLayout.even(len(points), closer)


def paces(points: np.ndarray, fps: float, apart: int) -> tuple[float, float]:
    """Return mean and 95th percentile of the acceleration of measured points between times so many frames apart, m/s².

    ``|x(t - h) - 2 x(t) + x(t + h)| / h²``: over the spacing h of keys, noise of 4 mm counts for 2.2 m/s².

    Args:
        points: (F, L, 3) metres, NaN where missing.
        fps: frames per second.
        apart: frames between keys.
    """
    apart = max(1, min(apart, (len(points) - 1) // 2))
    around = points[2 * apart :] - 2 * points[apart:-apart] + points[: -2 * apart]
    found = np.linalg.norm(around, axis=-1) * (fps / apart) ** 2
    found = found[np.isfinite(found)]
    return (float(found.mean()), float(np.quantile(found, 0.95))) if found.size else (0.0, 0.0)


def closer_window(window: int, pace: float, calm: float, closest: float) -> int:
    """Return ``w max(closest, min(1, √(calm / pace)))`` frames, two at least."""
    return max(2, round(window * max(closest, min(1.0, (calm / max(pace, 1e-6)) ** 0.5))))


def window_of(motion: Motion, window: int) -> int:
    """Return how many frames a window of an earlier solve has, ``window`` at most."""
    keys = 0 if motion.keyframes is None else int(motion.keyframes.sum())
    return window if keys < 3 else max(2, min(window, round(2 * motion.num_frames / keys)))
