"""A motion of ours or of AMASS, as a motion of the chosen body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.files.choices import load_chosen_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.load import load_motion
from solver_backend.io.motions.amass import AmassClip, motion_of
from solver_backend.types import Motion


def any_motion(path: Path, choice: str, *, keep_shape: bool = True) -> Motion:
    """Return a motion file's motion; of an AMASS file the poses on the chosen body, shape coefficients as they are.

    Args:
        path: motion file.
        choice: name or path of the body.
        keep_shape: use the shape coefficients of an AMASS file, which belong to the body that it was fitted with.

    Raises:
        MotionInvalid: it is neither.
        MocapError: see ``load_motion``.
    """
    motion = load_motion(path)
    if isinstance(motion, Motion):
        return motion
    if not isinstance(motion, AmassClip):
        raise MotionInvalid("The file is no motion of a body.", where=str(path), hint="Choose a motion .npz or AMASS.")
    if not keep_shape:
        motion = replace(motion, betas=np.zeros_like(motion.betas))
    body = load_chosen_body(choice)

    def joints_of(betas: np.ndarray, root: np.ndarray, pose: np.ndarray, transl: np.ndarray) -> np.ndarray:
        local = exp_so3(pose.reshape(len(pose), -1, 3))[:, : len(body.parents) - 1]
        return forward_kinematics(body, betas, exp_so3(root), local, transl).joints[:, :NUM_JOINTS]

    return motion_of(motion, body.id, joints_of)
