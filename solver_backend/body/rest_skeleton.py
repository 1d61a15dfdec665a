"""The skeleton that priors' errors are measured on: an adult of 1.70 m in the T-pose."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS

_LEFT = {
    1: (0.085, -0.088, 0.0), 4: (0.098, -0.470, 0.002), 7: (0.100, -0.865, -0.030), 10: (0.112, -0.922, 0.095),
    13: (0.072, 0.405, -0.022), 16: (0.178, 0.430, -0.030), 18: (0.440, 0.427, -0.045), 20: (0.690, 0.425, -0.045),
    22: (0.775, 0.418, -0.050),
}  # fmt: skip
_MIDDLE = {
    0: (0.0, 0.0, 0.0), 3: (0.0, 0.115, -0.020), 6: (0.0, 0.245, -0.015), 9: (0.0, 0.300, 0.005),
    12: (0.0, 0.505, -0.035), 15: (0.0, 0.595, 0.015),
}  # fmt: skip
_RIGHT_OF = {1: 2, 4: 5, 7: 8, 10: 11, 13: 14, 16: 17, 18: 19, 20: 21, 22: 23}
_PELVIS_HEIGHT = 0.945


def _rest_joints() -> np.ndarray:
    joints = np.zeros((NUM_JOINTS, 3))
    for joint, position in (_LEFT | _MIDDLE).items():
        joints[joint] = position
    for left, right in _RIGHT_OF.items():
        joints[right] = joints[left] * (-1.0, 1.0, 1.0)
    return joints + (0.0, _PELVIS_HEIGHT, 0.0)


REST_JOINTS: np.ndarray = _rest_joints()
"""(24, 3) metres, T-pose, Y up, facing +Z, left = +X; segment lengths of the middle adult (Drillis & Contini 1966)."""

MIRROR: tuple[int, ...] = tuple(
    _RIGHT_OF.get(j, {v: k for k, v in _RIGHT_OF.items()}.get(j, j)) for j in range(NUM_JOINTS)
)
"""Joint of the other side of the body."""
BODY_MIRROR: tuple[int, ...] = tuple(MIRROR[j] - 1 for j in range(1, 1 + NUM_BODY_JOINTS))
"""The same for the columns of joints 1..21."""

AXIS_TIPS_M: tuple[float, ...] = tuple(0.2 if joint == 15 else 0.1 for joint in range(NUM_JOINTS))
"""Distance of the three points along the axes of each joint's frame that make rotations count in metres."""
