"""A body's motion with its hands: as wide as the layout with fingers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.hand_of_body import in_order_of_smpl
from solver_backend.body.hands import with_hand_size
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.hand_points import SIDES
from solver_backend.fitters.hands.solve_hands import SolvedHands, statistics
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.symmetric import mean_sigma, packed
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import FLAG_RESTING, Motion

_UNSEEN_M = 0.04
"""Standard deviation per axis of the joints of a hand that nobody sees, metres."""


def with_hands(motion: Motion, hands: SolvedHands) -> Motion:
    """Return a motion with fingers; those that nobody sees rest relaxed, and are flagged.

    Args:
        motion: of the body without, its arms following the hands.
        hands: solved beside it.
    """
    body = with_hand_size(hands.body, hands.size) if hands.size != 1.0 else hands.body
    layout, narrow = body.layout, motion.body_layout
    shared = [narrow.joints.index(name) for name in layout.joints if name in narrow.joints]
    frames, kept = motion.num_frames, len(shared)
    turns = np.zeros((frames, layout.num_joints - 1, 3))
    turns[:, : kept - 1] = motion.body_pose.reshape(frames, -1, 3)[:, np.array(shared[1:]) - 1]
    covariance = np.zeros((frames, layout.num_joints, 6))
    covariance[:] = packed(_UNSEEN_M**2 * np.eye(3))
    if motion.joint_covariance is not None:
        covariance[:, :kept] = motion.joint_covariance[:, shared]
    resting = np.zeros((frames, layout.num_joints), dtype=bool)
    if motion.resting is not None:
        resting[:, :kept] = motion.resting[:, shared]
    for side, name in enumerate(SIDES):
        columns, hand = list(layout.group(f"{name}_hand")), hands.hands.get(side)
        if hand is None:
            skeleton = hands.skeletons[side]
            angles = np.broadcast_to(load_hand_prior().mean, (frames, skeleton.rest_angles.size))
            resting[:, columns] = True
        else:
            skeleton, angles = hand.problem.skeleton, hand.angles
            joints = hand.covariance[:, 1:].reshape(frames, 5, 4, 3, 3)[:, :, :3]
            covariance[:, columns] = packed(in_order_of_smpl(joints))
            resting[:, columns] = in_order_of_smpl(np.repeat(~hand.informed[:, :, None], 3, axis=2))
            covariance[:, layout.joints.index(f"{name}_wrist")] = packed(hand.covariance[:, 0])
        turns[:, np.array(columns) - 1] = log_so3(in_order_of_smpl(skeleton.local_rotations(angles)))
    root, transl = exp_so3(motion.global_orient), motion.transl
    posed = forward_kinematics(body, motion.betas, root, exp_so3(turns), transl)
    flags = None if motion.flags is None else motion.flags | np.where(resting[:, kept:].any(axis=1), FLAG_RESTING, 0)
    return replace(
        motion,
        body_pose=turns.reshape(frames, -1),
        joints=posed.joints,
        body_layout=layout,
        joint_covariance=None if motion.joint_covariance is None else covariance,
        joint_sigma=None if motion.joint_covariance is None else mean_sigma(covariance),
        resting=resting if resting.any() else motion.resting if motion.resting is None else resting,
        flags=None if flags is None else flags.astype(np.uint8),
        provenance={**motion.provenance, "hands": statistics(hands)},
    )
