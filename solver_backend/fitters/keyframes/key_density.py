"""How close keyframes stand: closer where people move faster."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.keyframes.optimise import BundleModel
from solver_backend.fitters.model.control_points import control_points
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.model.subject import pose
from solver_backend.geometry.arrays import to_numpy
from solver_backend.types import Motion

CALM_M_S2 = 5.2
"""Mean acceleration of the landmarks up to which the settings' window holds; exercises and walking have 2 to 5."""
CLOSEST = 0.6
"""Of the settings' window at least; dances, at 15 m/s², reach it."""


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
    points = to_numpy(pose(model.subject, frames).points)
    acceleration = float(np.linalg.norm(np.diff(points, 2, axis=0), axis=-1).mean()) * fps**2
    closer = max(2, round(window * max(CLOSEST, min(1.0, (CALM_M_S2 / max(acceleration, 1e-6)) ** 0.5))))
    return layout if closer >= window else KeyframeLayout.even(len(points), closer)


def window_of(motion: Motion, window: int) -> int:
    """Return how many frames a window of an earlier solve has, ``window`` at most."""
    keys = 0 if motion.keyframes is None else int(motion.keyframes.sum())
    return window if keys < 3 else max(2, min(window, round(2 * motion.num_frames / keys)))
