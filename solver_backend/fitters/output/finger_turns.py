"""Fingers of a motion: turned on a body's motion, and taken from one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hands import FIRST_FINGER, with_fingers, with_hand_size
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.small_matrices import mean_sigma
from solver_backend.types import FLAG_RESTING, Motion
from solver_backend.types.shapes import Bool, Float

FINGERS = slice(FIRST_FINGER, SMPL_HANDS.num_joints)
"""Columns of the finger joints."""
_WRISTS = tuple(
    SMPL_HANDS.joints.index(f"{SMPL_HANDS.groups[j].removesuffix('_hand')}_wrist")
    for j in range(FIRST_FINGER, SMPL_HANDS.num_joints)
)
"""Wrist of each finger joint."""


def with_finger_turns(
    motion: Motion,
    body: Body,
    turns: Float[np.ndarray, "frames 30 3"],
    resting: Bool[np.ndarray, "frames 30"] | None = None,
) -> Motion:
    """Return a motion as wide as ``SMPL_HANDS``, its fingers turned so.

    A finger's joint is as uncertain as its wrist: what gloves and clips leave open is not known.

    Args:
        turns: (F, 30, 3) axis-angles of the finger joints in SMPL-H's order, from the body's rest.
        resting: (F, 30) joints that nothing informs; None: all are informed.

    Raises:
        BodyInvalid: the body has no fingers, see ``with_fingers``.
    """
    size = float(motion.provenance.get("hands", {}).get("size", 1.0))
    fingered = with_fingers(body)
    wide = with_hand_size(fingered, size) if size != 1.0 else fingered
    layout, frames = wide.layout, motion.num_frames
    own = motion.body_pose.reshape(frames, -1, 3)[:, : FIRST_FINGER - 1]
    pose = np.concatenate([own, turns], axis=1)
    posed = forward_kinematics(wide, motion.betas, exp_so3(motion.global_orient), exp_so3(pose), motion.transl)
    parts: dict[str, np.ndarray | None] = {}
    if motion.joint_covariance is not None:
        parts["joint_covariance"] = _widened(motion.joint_covariance, motion.joint_covariance[:, list(_WRISTS)])
        parts["joint_sigma"] = mean_sigma(parts["joint_covariance"])
    elif motion.joint_sigma is not None:
        parts["joint_sigma"] = _widened(motion.joint_sigma, motion.joint_sigma[:, list(_WRISTS)])
    still = np.zeros((frames, len(_WRISTS)), bool) if resting is None else resting
    flags = motion.flags
    if still.any() or motion.resting is not None:
        before = np.zeros((frames, FIRST_FINGER), bool) if motion.resting is None else motion.resting
        parts["resting"] = _widened(before, still)
    if flags is not None:
        flags = (flags | np.where(still.any(axis=1), FLAG_RESTING, 0)).astype(np.uint8)
    return replace(
        motion, body_pose=pose.reshape(frames, -1), joints=posed.joints, body_layout=layout, flags=flags, **parts
    )


def finger_turns_of(motion: Motion) -> Float[np.ndarray, "frames 30 3"] | None:
    """Return (F, 30, 3) axis-angles of a motion's finger joints; None where it has none."""
    if not set(SMPL_HANDS.joints) <= set(motion.body_layout.joints):
        return None
    columns = [motion.body_layout.joints.index(joint) - 1 for joint in SMPL_HANDS.joints[FINGERS]]
    return motion.body_pose.reshape(motion.num_frames, -1, 3)[:, columns]


def _widened(values: np.ndarray, fingers: np.ndarray) -> np.ndarray:
    return np.concatenate([values[:, :FIRST_FINGER], fingers], axis=1)
