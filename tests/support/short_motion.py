"""A motion of the body that ships, with the joints that its kinematics give."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.hands import load_body_with_hands
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Motion


def short_motion(
    frames: int = 20, fps: float = 60.0, betas: np.ndarray | None = None, seed: int = 0, *, fingers: bool = False
) -> Motion:
    """Return a motion that walks ahead and turns every joint, smoothly; with fingers, of the body that has them."""
    body, rng = load_body_with_hands() if fingers else load_body(), np.random.default_rng(seed)
    betas = np.linspace(-1.5, 1.5, 10) if betas is None else betas
    turned, t = body.layout.recorded.num_solved, np.arange(frames) / fps
    swing = np.sin(3.0 * t[:, None, None] + rng.uniform(0, 6, (1, turned, 3)))
    pose = np.zeros((frames, body.layout.recorded.num_joints - 1, 3))
    pose[:, :turned] = 0.4 * swing
    root = np.tile([np.pi / 2, 0.0, 0.0], (frames, 1)) + 0.1 * swing[:, 0]
    transl = np.stack([0.2 * np.sin(t), -1.1 * t, 0.9 + 0.0 * t], axis=1)
    joints = forward_kinematics(body, betas, exp_so3(root), exp_so3(pose), transl).joints
    return Motion(
        betas=betas, global_orient=root, body_pose=pose.reshape(frames, -1), transl=transl, fps=fps, body=body.id,
        joints=joints[:, list(body.recorded_joints)], body_layout=body.layout.recorded,
    )  # fmt: skip
