"""A motion whose left fingers close."""

from __future__ import annotations

import numpy as np

from blender_addon._exchange.body_layout import SMPL_HANDS
from blender_addon._exchange.motion_file import MotionFile

FRAMES = 5
FINGERS = ("index", "middle", "ring", "pinky", "thumb")


def grasping(bend_rad: float) -> MotionFile:
    """Return a motion whose left fingers bend by the same angle at every joint."""
    layout = SMPL_HANDS
    rotvec = np.zeros((FRAMES, layout.num_joints, 3))
    rotvec[:, 0, 0] = np.pi / 2
    for finger in FINGERS[:4]:
        for i in (1, 2, 3):
            rotvec[:, layout.joints.index(f"left_{finger}{i}"), 2] = -bend_rad * np.linspace(0, 1, FRAMES)
    return MotionFile("grasp", rotvec, np.tile([0.0, 0, 0.95], (FRAMES, 1)), np.zeros(10), 30.0, body_layout=layout)
