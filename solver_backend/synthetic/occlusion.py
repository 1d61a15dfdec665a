"""Which keypoints a body hides from a camera by itself: sight lines against capsules around its bones."""

from __future__ import annotations

import numpy as np

from solver_backend.types import SMPL_JOINTS, Cameras

_CAPSULES: tuple[tuple[str, str, float], ...] = (
    ("pelvis", "spine2", 0.115), ("spine2", "spine3", 0.12), ("spine3", "neck", 0.10), ("neck", "head", 0.055),
    ("head", "head", 0.065),
    ("left_shoulder", "left_elbow", 0.045), ("right_shoulder", "right_elbow", 0.045),
    ("left_elbow", "left_wrist", 0.036), ("right_elbow", "right_wrist", 0.036),
    ("left_hip", "left_knee", 0.07), ("right_hip", "right_knee", 0.07),
    ("left_knee", "left_ankle", 0.048), ("right_knee", "right_ankle", 0.048),
    ("left_ankle", "left_foot", 0.036), ("right_ankle", "right_foot", 0.036),
)  # fmt: skip
"""Ends and radius in metres; slimmer than the skin, so that points on the skin are seen."""
_HEAD_ABOVE_JOINT_M = 0.06
_CLEARANCE_M = 0.03
"""The sight line ends this far before the point."""
_TRUNK = ("pelvis", "spine2", "spine3")


def self_occluded(cameras: Cameras, joints: np.ndarray, points: np.ndarray, keypoints: tuple[str, ...]) -> np.ndarray:
    """Return (C, F, K) bool: a part of the body that the keypoint does not belong to stands in its sight line.

    Args:
        cameras: C cameras.
        joints: (F, 24, 3) metres.
        points: (F, K, 3) the keypoints' true places.
        keypoints: names of the K keypoints.
    """
    eye = cameras.centres[:, None, None]
    way = points[None] - eye
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    end = eye + way * (1.0 - _CLEARANCE_M / np.maximum(length, 2 * _CLEARANCE_M))
    hidden = np.zeros(end.shape[:3], dtype=bool)
    for first, last, radius in _CAPSULES:
        a, b = joints[:, SMPL_JOINTS.index(first)], joints[:, SMPL_JOINTS.index(last)]
        if first == last:
            up = joints[:, SMPL_JOINTS.index("head")] - joints[:, SMPL_JOINTS.index("neck")]
            a = b = a + _HEAD_ABOVE_JOINT_M * up / np.linalg.norm(up, axis=-1, keepdims=True)
        near = segment_distance(eye, end, a[None, :, None], b[None, :, None]) < radius
        own = np.array([_belongs(name, first, last) for name in keypoints])
        hidden |= near & ~own
    return hidden


def segment_distance(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the least distance between segments p-q and a-b, broadcast over leading axes.

    Reference: Ericson 2004, "Real-Time Collision Detection", 5.1.9.
    """
    d1, d2, r = q - p, b - a, p - a
    aa, ee = _dot(d1, d1), np.maximum(_dot(d2, d2), 1e-12)
    f, c, bb = _dot(d2, r), _dot(d1, r), _dot(d1, d2)
    denominator = aa * ee - bb * bb
    s = np.where(denominator > 1e-12, (bb * f - c * ee) / np.maximum(denominator, 1e-12), -c / aa)
    s = np.clip(s, 0.0, 1.0)
    t = (bb * s + f) / ee
    s = np.where(t < 0, np.clip(-c / aa, 0, 1), np.where(t > 1, np.clip((bb - c) / aa, 0, 1), s))
    t = np.clip(t, 0.0, 1.0)
    return np.linalg.norm(r + s[..., None] * d1 - t[..., None] * d2, axis=-1)


def _dot(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (u * v).sum(-1)


def _belongs(keypoint: str, first: str, last: str) -> bool:
    """Say whether a keypoint is part of the capsule: it ends there, or lies within the trunk's or foot's flesh."""
    if keypoint in (first, last):
        return True
    if keypoint in ("neck", "upper_neck", "thorax", "spine", "mid_hip") or keypoint.endswith(("_hip", "_shoulder")):
        return first in _TRUNK or first == "neck"
    if keypoint.endswith(("_toe", "_heel")):
        side = keypoint.split("_")[0]
        return first in (f"{side}_ankle", f"{side}_knee")
    return False
