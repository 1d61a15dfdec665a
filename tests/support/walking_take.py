"""A take of a walk written as formulas, and a detector without errors to film it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.faults import DetectorFaults
from solver_backend.synthesis.simulation.cast import Take

EXACT = DetectorFaults()  # A detector that errs nowhere.


def walk(num_frames: int = 90) -> Take:
    """Return a person who swings arms and legs and drifts forward, the pelvis a metre high."""
    phase = 2 * np.pi * np.arange(num_frames) / 60.0
    rotvec = np.zeros((num_frames, 22, 3))
    rotvec[:, 1, 0], rotvec[:, 2, 0] = -0.4 * np.sin(phase), 0.4 * np.sin(phase)
    rotvec[:, 16, 2], rotvec[:, 17, 2] = -1.1, 1.1
    root = np.stack([0 * phase, 1.0 + 0.02 * np.cos(2 * phase), phase / 6], axis=1)
    return Take("walk", exp_so3(rotvec), root, 60.0)


def circling(frames: int = 60) -> Take:
    """Return a walk around a circle of 1.2 m, which fills the space."""
    take = walk(frames)
    angle = 2 * np.pi * np.arange(frames) / frames
    turn = np.zeros((frames, 3))
    turn[:, 1] = np.pi / 2 - angle
    rotations = take.rotations.copy()
    rotations[:, 0] = exp_so3(turn) @ rotations[:, 0]
    root = np.stack([1.2 * np.cos(angle), take.root[:, 1], 1.2 * np.sin(angle)], axis=1)
    return replace(take, rotations=rotations, root=root)
