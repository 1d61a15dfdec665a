"""A body's motion with its hands: as wide as the layout with fingers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_on_body import by_joint
from solver_backend.body.hands import with_fingers, with_hand_size
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.hand_points import SIDES
from solver_backend.fitters.hands.solve_hands import SolvedHands, statistics
from solver_backend.fitters.keyframes.frame_range import FrameRange
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
            covariance[:, columns] = packed(by_joint(joints))
            resting[:, columns] = by_joint(np.repeat(~hand.informed[:, :, None], 3, axis=2))
            covariance[:, layout.joints.index(f"{name}_wrist")] = packed(hand.covariance[:, 0])
        turns[:, np.array(columns) - 1] = log_so3(by_joint(skeleton.local_rotations(angles)))
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
        resting=resting if motion.resting is not None or resting.any() else None,
        flags=None if flags is None else flags.astype(np.uint8),
        provenance={**motion.provenance, "hands": statistics(hands)},
    )


def without_fingers(motion: Motion) -> Motion:
    """Return the motion of the body alone, as solves of bodies take it; the same one where it has no fingers.

    The hands' own joints, which SMPL has in the fingers' place, are at the knuckles of the middle fingers, at rest.
    """
    layout = motion.body_layout
    if layout.joints == SMPL.joints or not set(SMPL_HANDS.joints) <= set(layout.joints):
        return motion
    columns = list(layout.standing_for(SMPL))
    turns = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, np.array(columns[1:]) - 1].copy()
    turns[:, SMPL.num_solved :] = 0.0
    parts = {
        name: value[:, columns]
        for name in ("joints", "joint_sigma", "joint_covariance", "resting")
        if (value := getattr(motion, name)) is not None
    }
    return replace(motion, body_pose=turns.reshape(motion.num_frames, -1), body_layout=SMPL, **parts)


def with_fingers_of(motion: Motion, earlier: Motion, frame_range: FrameRange, body: Body) -> Motion:
    """Return a motion solved again with the fingers of the earlier one, and those of pinned poses at their frames.

    What a pin changes fades linearly to the next pin and to the ends of the range.

    Args:
        motion: solved again, without fingers.
        earlier: as it was; the motion is returned as it is where this has no fingers.
        frame_range: what was solved again.
        body: of both.
    """
    if earlier.body_layout.num_joints == motion.body_layout.num_joints:
        return motion
    layout, kept = earlier.body_layout, 1 + SMPL.num_solved
    turns = earlier.body_pose.reshape(earlier.num_frames, -1, 3).copy()
    turns[:, : kept - 1] = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, : kept - 1]
    pins = [pin for pin in frame_range.pins if len(pin.body_pose) == turns[0].size]
    changed = [pin.body_pose.reshape(-1, 3)[kept - 1 :] - turns[pin.frame, kept - 1 :] for pin in pins]
    stops = [frame_range.first, *(pin.frame for pin in pins), frame_range.last]
    still = np.zeros_like(turns[0, kept - 1 :])
    values = np.stack([still, *changed, still]).reshape(len(stops), -1)
    order, frames = np.argsort(stops, kind="stable"), np.arange(frame_range.first, frame_range.last + 1)
    faded = [np.interp(frames, np.array(stops)[order], column[order]) for column in values.T]
    turns[frames, kept - 1 :] += np.stack(faded, axis=-1).reshape(len(frames), -1, 3)
    sized = with_hand_size(with_fingers(body), float(earlier.provenance.get("hands", {}).get("size", 1.0)))
    posed = forward_kinematics(
        sized, motion.betas, exp_so3(motion.global_orient), exp_so3(turns), motion.transl
    )  # fmt: skip
    parts = {}
    for name in ("joint_sigma", "joint_covariance", "resting"):
        own, before = getattr(motion, name), getattr(earlier, name)
        if own is not None and before is not None:
            parts[name] = np.concatenate([own[:, :kept], before[:, kept:]], axis=1)
        elif name == "resting" and before is not None:
            parts[name] = np.concatenate([np.zeros_like(before[:, :kept]), before[:, kept:]], axis=1)
        else:
            parts[name] = None
    return replace(
        motion, body_pose=turns.reshape(motion.num_frames, -1), joints=posed.joints, body_layout=layout, **parts
    )  # fmt: skip
