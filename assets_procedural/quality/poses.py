"""Poses that strain a skinned body: single bends for measurements and thirteen extremes to look at."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from assets_procedural.layout import JOINT, PARENTS

Degrees = dict[str, tuple[float, float, float]]

BENDS: dict[str, Degrees] = {
    "elbow": {"left_elbow": (0, -1, 0), "right_elbow": (0, 1, 0)},
    "knee": {"left_knee": (1, 0, 0), "right_knee": (1, 0, 0)},
    "hip": {"left_hip": (-1, 0, 0), "right_hip": (-1, 0, 0)},
    "shoulder": {"left_shoulder": (0, -1, 0), "right_shoulder": (0, 1, 0)},
}
"""Axis of each bend, both sides; the shoulder's brings the arms forward."""

EXTREMES: dict[str, Degrees] = {
    "high knee": {"left_hip": (-90, 0, 0), "left_knee": (90, 0, 0), "right_elbow": (0, 90, 0)},
    "deep squat": {
        "left_hip": (-115, 0, 14),
        "right_hip": (-115, 0, -14),
        "left_knee": (125, 0, 0),
        "right_knee": (125, 0, 0),
        "left_ankle": (-25, 0, 0),
        "right_ankle": (-25, 0, 0),
        "spine1": (15, 0, 0),
        "spine2": (10, 0, 0),
        "left_shoulder": (0, -80, 0),
        "right_shoulder": (0, 80, 0),
    },
    "cross-legged": {
        "left_hip": (-92, 82, -15),
        "right_hip": (-92, -82, 15),
        "left_knee": (130, 0, 0),
        "right_knee": (130, 0, 0),
    },
    "arms down": {
        "left_collar": (0, 0, -8),
        "right_collar": (0, 0, 8),
        "left_shoulder": (0, 0, -70),
        "right_shoulder": (0, 0, 70),
        "left_elbow": (0, -15, 0),
    },
    "arms up": {
        "left_collar": (0, 0, 22),
        "right_collar": (0, 0, -22),
        "left_shoulder": (0, 0, 65),
        "right_shoulder": (0, 0, -65),
    },
    "hands to face": {
        "left_shoulder": (0, -55, -25),
        "right_shoulder": (0, 55, 25),
        "left_elbow": (0, -135, 0),
        "right_elbow": (0, 135, 0),
    },
    "forearm twist": {
        "left_wrist": (90, 0, 0),
        "right_wrist": (-90, 0, 0),
        "left_elbow": (0, -60, 0),
        "right_shoulder": (0, 30, 50),
    },
    "toe touch": {
        "spine1": (30, 0, 0),
        "spine2": (25, 0, 0),
        "spine3": (20, 0, 0),
        "neck": (25, 0, 0),
        "left_hip": (-50, 0, 0),
        "right_hip": (-50, 0, 0),
        "left_shoulder": (0, -80, -20),
        "right_shoulder": (0, 80, 20),
    },
    "trunk twist": {
        "spine1": (0, 25, 0),
        "spine2": (0, 25, 0),
        "spine3": (0, 20, 0),
        "neck": (0, 30, 0),
        "head": (0, 25, 0),
        "left_shoulder": (0, 0, -60),
        "right_shoulder": (0, 0, 60),
    },
    "side split": {"left_hip": (0, 0, 65), "right_hip": (0, 0, -65)},
    "kick back": {
        "right_hip": (35, 0, 0),
        "right_knee": (120, 0, 0),
        "left_ankle": (-25, 0, 0),
        "left_shoulder": (0, 0, 60),
        "right_shoulder": (0, -30, 40),
        "spine1": (-20, 0, 0),
        "spine2": (-15, 0, 0),
    },
    "side bend": {
        "spine1": (0, 0, 22),
        "spine2": (0, 0, 20),
        "spine3": (0, 0, 12),
        "neck": (0, 0, 25),
        "left_shoulder": (0, 0, -70),
        "right_collar": (0, 0, -15),
        "right_shoulder": (0, 0, -75),
    },
    "lunge and throw": {
        "left_hip": (-85, 0, 10),
        "left_knee": (85, 0, 0),
        "right_hip": (25, 0, 0),
        "right_knee": (25, 0, 0),
        "right_foot": (-30, 0, 0),
        "right_shoulder": (0, -25, -20),
        "right_elbow": (0, 100, 0),
        "right_wrist": (0, 0, 45),
        "left_shoulder": (0, -40, -15),
        "spine2": (0, 20, 0),
        "head": (0, 35, 0),
    },
}
"""Thirteen poses by name, joint rotation vectors in degrees."""


def rotations(pose: Degrees, scale: float = 1.0) -> np.ndarray:
    """Return the (24, 3, 3) local rotations of a pose, every angle multiplied by ``scale``."""
    vectors = np.zeros((len(PARENTS), 3))
    for name, degrees in pose.items():
        vectors[JOINT[name]] = np.deg2rad(np.array(degrees, dtype=np.float64) * scale)
    return Rotation.from_rotvec(vectors).as_matrix()
