"""A take in which everything moves, the fingers too."""

from __future__ import annotations

import numpy as np

from blender_addon._exchange.body_layout import SMPL_HANDS
from blender_addon._exchange.motion_file import MotionFile

FRAMES = 20


def moving_fingers(body: str = "manifold_neutral", fps: float = 30.0) -> MotionFile:
    """Return a motion of 52 joints, each of which swings about an axis of its own."""
    rng = np.random.default_rng(0)
    axes, phases = 0.35 * rng.normal(size=(52, 3)), rng.uniform(0, 2 * np.pi, 52)
    t = np.linspace(0.0, 2 * np.pi, FRAMES)[:, None]
    rotvec = np.sin(t + phases)[..., None] * axes
    rotvec[:, 0] += [1.2, 0.0, 0.0]
    transl = np.stack([0.1 * t[:, 0], 0.0 * t[:, 0], 1.0 + 0.0 * t[:, 0]], axis=1)
    return MotionFile("fingers", rotvec, transl, 0.5 * rng.normal(size=10), fps, body, SMPL_HANDS)
