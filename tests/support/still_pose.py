"""The rest pose as a motion, with some joints turned."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.geometry.rotations import log_so3
from solver_backend.types import Motion


def still(frames: int = 1, **turns: np.ndarray) -> Motion:
    """Return the rest pose, upright and facing -y of the world, with some joints turned by rotation vectors."""
    pose = np.zeros((frames, 23, 3))
    for joint, turn in turns.items():
        pose[:, SMPL.joints.index(joint) - 1] = turn
    upright = np.tile(log_so3(np.array([[[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]]))[0], (frames, 1))
    return Motion(
        betas=np.zeros(10), global_orient=upright, body_pose=pose.reshape(frames, -1), transl=np.zeros((frames, 3)),
        fps=100.0, body=load_body().id, joints=np.zeros((frames, 24, 3)),
    )  # fmt: skip
