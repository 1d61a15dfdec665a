"""Measure how far the SMPL family's body joints exceed their ranges of motion.

A rotation is split into a twist about the bone and a swing (Grassia 1998). This gives three angles about the axes of
the T-pose (x to the left, y up, z forward). One is the twist, and the other two form the swing's rotation vector.
"""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_JOINTS
from solver_backend.geometry.arrays import Array, array_namespace, constant
from solver_backend.geometry.rotations import exp_so3, quat_conjugate, quat_from_matrix, quat_multiply, rotvec_from_quat

_POSES = 2000  # Number of poses processed at a time.
MARGIN_DEG = 15.0  # Tolerance at both ends, for differences between people (10 to 15 degrees) and between conventions.


def excess_deg(local: Array) -> Array:
    """Return the degrees (N, 21) by which joints 1..21 exceed their range plus a margin, or 0 for joints within it."""
    return _beyond(swing_and_twist(local) * (180.0 / np.pi), _LOW, _HIGH)


def posture_excess_deg(local: Array) -> Array:
    """Return excess degrees (N, 21) as ``excess_deg`` does, but measure knees by the shin's direction.

    People who sit cross-legged or kneel bend their knees to 157 +- 6 degrees (Hemmerich et al. 2006, with raised
    heels). Near 180 degrees, a tilt of the knee's swing axis barely moves the shin sideways. The flexion of the knees
    is therefore ``atan2(-d_z, -d_y)``, and their sideways angle is ``asin(d_x)``, with the shin's unit direction d.
    """
    xp = array_namespace(local)
    if local.shape[0] > _POSES:
        parts = [local[start : start + _POSES] for start in range(0, local.shape[0], _POSES)]
        return xp.concat([posture_excess_deg(part) for part in parts])
    angles = swing_and_twist(local) * (180.0 / np.pi)
    shin = -local[..., :, 1]  # only the swing moves it, because twists are about the bone
    flexion = xp.atan2(-shin[..., 2], -shin[..., 1]) * (180.0 / np.pi)
    flexion = xp.where(flexion < -135.0, flexion + 360.0, flexion)
    sideways = xp.asin(xp.clip(shin[..., 0], -1.0, 1.0)) * (180.0 / np.pi)
    knees = xp.stack((flexion, angles[..., 1], sideways), axis=-1)
    angles = xp.where(constant(_IS_KNEE, local) > 0.5, knees, angles)
    return _beyond(angles, _LOW, np.where(_IS_KNEE * [1.0, 0.0, 0.0] > 0.5, _DEEPEST_KNEE_DEG, _HIGH))


def swing_and_twist(local: Array) -> Array:
    """Split (N, 21, 3, 3) rotations ``R = swing · twist`` into (N, 21, 3) angles in radians about x, y and z."""
    xp = array_namespace(local)
    q = quat_from_matrix(local)
    along = constant(_TWIST, local)
    twist = xp.concat((q[..., :1], q[..., 1:] * along), axis=-1)
    length = xp.sqrt(xp.sum(twist * twist, axis=-1, keepdims=True))
    flipped = length < 1e-9
    none = constant((1.0, 0.0, 0.0, 0.0), local) + xp.zeros_like(twist)
    twist = xp.where(flipped, none, twist / xp.where(flipped, xp.ones_like(length), length))
    swing = quat_multiply(q, quat_conjugate(twist))
    return rotvec_from_quat(twist) + rotvec_from_quat(swing)


def from_swing_and_twist(angles: Array) -> Array:
    """Convert (N, 21, 3) angles to (N, 21, 3, 3) rotations, inverting ``swing_and_twist``."""
    twist = constant(_TWIST, angles) * angles
    return array_namespace(angles).matmul(exp_so3(angles - twist), exp_so3(twist))


def _table() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    low, high, twist = (np.zeros((NUM_BODY_JOINTS, 3)) for _ in range(3))
    for column, joint in enumerate(SMPL_JOINTS[1 : 1 + NUM_BODY_JOINTS]):
        limit = SMPL.limits[joint]
        twist[column, limit.twist] = 1.0
        low[column], high[column] = limit.low_deg, limit.high_deg
    return low, high, twist


def _beyond(angles: Array, low_deg: np.ndarray, high_deg: np.ndarray) -> Array:
    xp = array_namespace(angles)
    low, high = constant(low_deg - MARGIN_DEG, angles), constant(high_deg + MARGIN_DEG, angles)
    beyond = xp.where(angles > high, angles - high, xp.where(angles < low, low - angles, xp.zeros_like(angles)))
    return xp.max(beyond, axis=-1)


_LOW, _HIGH, _TWIST = _table()
_IS_KNEE = np.array([[float(joint.endswith("knee"))] for joint in SMPL_JOINTS[1 : 1 + NUM_BODY_JOINTS]])
_DEEPEST_KNEE_DEG = 163.0  # Mean plus standard deviation of maximum flexion in 30 adults (Hemmerich et al. 2006).
JOINT_LIMITS: np.ndarray = np.radians(np.stack((_LOW - MARGIN_DEG, _HIGH + MARGIN_DEG), axis=-1))
"""(21, 3, 2) smallest and largest angle of each joint in radians, including the margin."""
