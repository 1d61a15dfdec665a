"""Define the skeleton for evaluating pose priors: an adult of 1.70 m in T-pose."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.body_layout import SMPL

_LEFT = {
    "left_hip": (0.085, -0.088, 0.0), "left_knee": (0.098, -0.470, 0.002), "left_ankle": (0.100, -0.865, -0.030),
    "left_foot": (0.112, -0.922, 0.095), "left_collar": (0.072, 0.405, -0.022), "left_shoulder": (0.178, 0.430, -0.030),
    "left_elbow": (0.440, 0.427, -0.045), "left_wrist": (0.690, 0.425, -0.045), "left_hand": (0.775, 0.418, -0.050),
}  # fmt: skip
_MIDDLE = {
    "pelvis": (0.0, 0.0, 0.0), "spine1": (0.0, 0.115, -0.020), "spine2": (0.0, 0.245, -0.015),
    "spine3": (0.0, 0.300, 0.005), "neck": (0.0, 0.505, -0.035), "head": (0.0, 0.595, 0.015),
}  # fmt: skip
_PELVIS_HEIGHT = 0.945  # Height of the neutral body's pelvis above the floor in metres.


def _rest_joints() -> np.ndarray:
    joints = np.zeros((SMPL.num_joints, 3))
    for name, position in (_LEFT | _MIDDLE).items():
        joint = SMPL.joints.index(name)
        joints[SMPL.mirror[joint]] = np.multiply(position, (-1.0, 1.0, 1.0))
        joints[joint] = position
    return joints + (0.0, _PELVIS_HEIGHT, 0.0)


REST_JOINTS: np.ndarray = _rest_joints()  # (24, 3) metres. Segment lengths: Drillis and Contini 1966.

MIRROR: tuple[int, ...] = SMPL.mirror  # Corresponding joint on the other side of the body.
BODY_MIRROR: tuple[int, ...] = tuple(joint - 1 for joint in MIRROR[1 : 1 + SMPL.num_solved])
