"""A motion of ours or of AMASS, as a motion of the chosen body, with its fingers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from solver_backend.body.files.choices import load_chosen_body
from solver_backend.body.hands import flat_hands
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.errors import BodyInvalid, MotionInvalid
from solver_backend.exchange.finger_joints import from_flat
from solver_backend.exchange.joint_sets import NUM_JOINTS
from solver_backend.fitters.hands.wide_motion import with_finger_turns
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.load import load_motion
from solver_backend.io.motions.amass import AmassClip, motion_of
from solver_backend.types import Motion


def any_motion(path: Path, choice: str, *, keep_shape: bool = True) -> Motion:
    """Return a motion file's motion; of an AMASS file the poses on the chosen body, shape coefficients as they are.

    Fingers that an AMASS file turns are kept; a body without finger joints shows them at rest.

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
        raise MotionInvalid(
            "The file is not a motion of a body.", where=str(path), hint="Choose a motion .npz or AMASS."
        )
    if not keep_shape:
        motion = replace(motion, betas=np.zeros_like(motion.betas))
    body = load_chosen_body(choice)

    def joints_of(betas: np.ndarray, root: np.ndarray, pose: np.ndarray, transl: np.ndarray) -> np.ndarray:
        local = exp_so3(pose.reshape(len(pose), -1, 3))[:, : len(body.parents) - 1]
        return forward_kinematics(body, betas, exp_so3(root), local, transl).joints[:, :NUM_JOINTS]

    made, hands = motion_of(motion, body.id, joints_of), motion.hand_pose
    if hands is None or not hands.any():
        return made
    turns = log_so3(from_flat(exp_so3(hands.reshape(len(hands), -1, 3)), flat_hands(body)))
    try:
        return with_finger_turns(made, body, turns)
    except BodyInvalid:
        return made
