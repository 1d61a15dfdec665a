"""Compute joint angles from joint positions alone."""

from __future__ import annotations

import numpy as np

from solver_backend.types import SMPL_JOINTS


def flexion_deg(joints: np.ndarray, parent: str, joint: str, child: str) -> np.ndarray:
    """Return the (F,) flexion of a hinge joint in degrees from (F, 24, 3) joints, 0 if straight."""
    above = _between(joints, joint, parent)
    below = _between(joints, joint, child)
    return 180.0 - _angle_deg(above, below)


def knee_flexion_deg(joints: np.ndarray, side: str) -> np.ndarray:
    """Return the (F,) knee flexion in degrees (hip-knee-ankle, thesis 6.3.4)."""
    return flexion_deg(joints, f"{side}_hip", f"{side}_knee", f"{side}_ankle")


def elbow_flexion_deg(joints: np.ndarray, side: str) -> np.ndarray:
    """Return the (F,) elbow flexion in degrees (shoulder-elbow-wrist)."""
    return flexion_deg(joints, f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist")


def hip_flexion_deg(joints: np.ndarray, side: str) -> np.ndarray:
    """Return the (F,) sagittal angle between thigh and trunk in degrees, positive forwards."""
    thigh = _between(joints, f"{side}_hip", f"{side}_knee")
    down = _unit_vectors(_between(joints, "neck", "pelvis"))
    forward = _unit_vectors(np.cross(down, _between(joints, "right_hip", "left_hip")))
    return np.degrees(np.arctan2((thigh * forward).sum(-1), (thigh * down).sum(-1)))


def shoulder_elevation_deg(joints: np.ndarray, side: str) -> np.ndarray:
    """Return the (F,) angle between upper arm and trunk in degrees: 0 hanging, 180 overhead."""
    return _angle_deg(_between(joints, f"{side}_shoulder", f"{side}_elbow"), _between(joints, "neck", "pelvis"))


def trunk_lean_deg(joints: np.ndarray) -> np.ndarray:
    """Return the (F,) angle in degrees between the trunk (pelvis to neck) and the vertical."""
    return _angle_deg(_between(joints, "pelvis", "neck"), np.array([0.0, 0.0, 1.0]))


def foot_height_cm(joints: np.ndarray, side: str) -> np.ndarray:
    """Return the (F,) height of the ball of the foot above the floor in centimetres."""
    return 100.0 * joints[:, SMPL_JOINTS.index(f"{side}_foot"), 2]


def _between(joints: np.ndarray, start: str, end: str) -> np.ndarray:
    return joints[:, SMPL_JOINTS.index(end)] - joints[:, SMPL_JOINTS.index(start)]


def _angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ``atan2(|a × b|, a·b)`` in degrees, which is accurate even near 0 and 180."""
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(cross, (a * b).sum(-1)))


def _unit_vectors(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)
