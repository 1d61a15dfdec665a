"""A stick figure with SMPL's joints and no skin, for solver tests that need no assets."""

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.body_layout import SMPL

_LEFT = {
    1: (0.09, -0.08, 0.0), 4: (0.10, -0.47, 0.0), 7: (0.10, -0.87, -0.02), 10: (0.11, -0.92, 0.11),
    13: (0.07, 0.42, -0.02), 16: (0.18, 0.44, -0.02), 18: (0.44, 0.44, -0.03), 20: (0.69, 0.44, -0.03),
    22: (0.77, 0.44, -0.03),
}  # fmt: skip
_MIDDLE = {
    0: (0, 0, 0), 3: (0, 0.11, -0.02), 6: (0, 0.24, -0.01), 9: (0, 0.30, 0.0), 12: (0, 0.50, -0.02),
    15: (0, 0.59, 0.02),
}  # fmt: skip


def stick_body() -> Body:
    joints = np.zeros((24, 3))
    for j, p in _MIDDLE.items():
        joints[j] = p
    for j, p in _LEFT.items():
        joints[j] = p
        joints[j + 1] = np.array(p) * [-1, 1, 1]
    shapedirs = np.zeros((24, 3, 10))
    shapedirs[..., 0] = 0.04 * joints
    shapedirs[:, 0, 1] = 0.03 * joints[:, 0]
    for k in range(2, 10):
        shapedirs[:, :, k] = 0.004 * np.random.default_rng(k).normal(size=(24, 3))
    eye = np.eye(24)
    return Body("stick", joints, shapedirs, np.zeros((24, 3, 207)), eye, eye, SMPL, np.zeros((0, 3), int))
