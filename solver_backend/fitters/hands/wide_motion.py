"""A body's motion with hands, in the layout with fingers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hands import FIRST_FINGER, by_joint, with_fingers, with_hand_size
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.small_matrices import mean_sigma, packed
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import FLAG_RESTING, Motion
from solver_backend.types.shapes import Bool, Float

if TYPE_CHECKING:
    from solver_backend.fitters.hands.solve_hands import HandRange, SolvedHands
    from solver_backend.fitters.keyframes.splice_range import SolvedRange

_UNSEEN_M = 0.04  # Standard deviation per axis of the joints of a hand that no view shows, metres.


def with_hands(motion: Motion, hands: SolvedHands, statistics: Mapping[str, object]) -> Motion:
    """Return a motion with fingers and the hands' ``statistics``. Unseen fingers rest relaxed, and are flagged."""
    body = with_hand_size(hands.body, hands.size)
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
        provenance={**motion.provenance, "hands": dict(statistics)},
    )


def without_fingers(motion: Motion) -> Motion:
    """Return the motion of the body alone, the same one where it has no fingers.

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


def hand_size_in(motion: Motion) -> float:
    """Return the size of a motion's hands by that of the body's shape, 1 where it states none."""
    return float(motion.provenance.get("hands", {}).get("size", 1.0))


def with_fingers_of(
    motion: Motion, earlier: Motion, solved: SolvedRange, hands: Mapping[int, HandRange], body: Body
) -> Motion:
    """Return a motion solved again with fingers: those solved with it, the others as in the earlier motion.

    Fingers meet the earlier ones at the ends of the range and the pinned ones at pins. The rest, all of it where
    nothing was measured, fades linearly to the next pin or end. The motion is returned as it is where the earlier one
    has no fingers.
    """
    if earlier.body_layout.num_joints == motion.body_layout.num_joints:
        return motion
    layout, kept, moved = earlier.body_layout, 1 + SMPL.num_solved, solved.moved
    turns = earlier.body_pose.reshape(earlier.num_frames, -1, 3).copy()
    before = turns[:, kept - 1 :].copy()
    turns[:, : kept - 1] = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, : kept - 1]
    parts = _beside(motion, earlier, kept)
    if parts["resting"] is None and not all(again.hand.informed.all() for again in hands.values()):
        parts["resting"] = np.zeros((earlier.num_frames, layout.num_joints), bool)
    for side, again in hands.items():
        columns, hand = np.array(layout.group(f"{SIDES[side]}_hand")), again.hand
        inside = np.isin(again.frames, moved)
        rows = np.ix_(again.frames[inside], columns)
        turns[rows[0], rows[1] - 1] = log_so3(by_joint(hand.problem.skeleton.local_rotations(hand.angles[inside])))
        if parts["resting"] is not None:
            parts["resting"][rows] = by_joint(np.repeat(~hand.informed[inside][:, :, None], 3, axis=2))
        if parts["joint_covariance"] is not None:
            joints = hand.covariance[inside][:, 1:].reshape(-1, 5, 4, 3, 3)[:, :, :3]
            parts["joint_covariance"][rows] = packed(by_joint(joints))
            parts["joint_sigma"][rows] = mean_sigma(parts["joint_covariance"][rows])
    turns[:, kept - 1 :] += _left_at_stops(turns[:, kept - 1 :], before, solved)
    sized = with_hand_size(with_fingers(body), hand_size_in(earlier))
    posed = forward_kinematics(sized, motion.betas, exp_so3(motion.global_orient), exp_so3(turns), motion.transl)
    flags, resting = motion.flags, parts["resting"]
    if flags is not None and resting is not None:
        flags = flags.copy()
        flags[moved] |= np.where(resting[moved, kept:].any(axis=1), FLAG_RESTING, 0).astype(flags.dtype)
    return replace(
        motion,
        body_pose=turns.reshape(motion.num_frames, -1),
        joints=posed.joints,
        body_layout=layout,
        flags=flags,
        **parts,
    )


def _beside(motion: Motion, earlier: Motion, kept: int) -> dict[str, Any]:
    parts: dict[str, Any] = {}
    for name in ("joint_sigma", "joint_covariance", "resting"):
        own, before = getattr(motion, name), getattr(earlier, name)
        if own is not None and before is not None:
            parts[name] = np.concatenate([own[:, :kept], before[:, kept:]], axis=1)
        elif name == "resting" and before is not None:
            parts[name] = np.concatenate([np.zeros_like(before[:, :kept]), before[:, kept:]], axis=1)
        else:
            parts[name] = None
    return parts


def _left_at_stops(turns: np.ndarray, before: np.ndarray, solved: SolvedRange) -> np.ndarray:
    """Return (F, J, 3) differences of fingers from the earlier and the pinned ones, faded between ends and pins."""
    wanted, moved = solved.frame_range, set(solved.moved.tolist())
    pins = {pin.frame: pin.body_pose.reshape(-1, 3) for pin in wanted.pins}
    wide = {frame: pose[-before.shape[1] :] for frame, pose in pins.items() if len(pose) > SMPL.num_joints - 1}
    stops = {frame: before[frame] for frame in (wanted.first, wanted.last) if frame not in moved} | wide
    faded = np.zeros_like(turns)
    if not stops:
        return faded
    at, frames = np.array(sorted(stops)), np.arange(wanted.first, wanted.last + 1)
    left = np.stack([stops[frame] - turns[frame] for frame in at]).reshape(len(at), -1)
    columns = [np.interp(frames, at, column) for column in left.T]
    faded[frames] = np.stack(columns, axis=-1).reshape(len(frames), *turns.shape[1:])
    return faded


FINGERS = slice(FIRST_FINGER, SMPL_HANDS.num_joints)  # Columns of the finger joints.
_WRISTS = [
    SMPL_HANDS.joints.index(f"{SMPL_HANDS.groups[j].removesuffix('_hand')}_wrist")
    for j in range(FIRST_FINGER, SMPL_HANDS.num_joints)
]
"""Wrist of each finger joint."""


def with_finger_turns(
    motion: Motion,
    body: Body,
    turns: Float[np.ndarray, "frames 30 3"],
    resting: Bool[np.ndarray, "frames 30"] | None = None,
) -> Motion:
    """Return a motion as wide as ``SMPL_HANDS`` with turned fingers.

    A finger's joint is as uncertain as its wrist, as gloves and clips state nothing.

    Args:
        turns: (F, 30, 3) axis-angles of the finger joints in SMPL-H's order, from the body's rest.
        resting: (F, 30) joints that nothing informs; None: all are informed.

    Raises:
        BodyInvalid: the body has no fingers, see ``with_fingers``.
    """
    wide = with_hand_size(with_fingers(body), hand_size_in(motion))
    layout, frames = wide.layout, motion.num_frames
    own = motion.body_pose.reshape(frames, -1, 3)[:, : FIRST_FINGER - 1]
    pose = np.concatenate([own, turns], axis=1)
    posed = forward_kinematics(wide, motion.betas, exp_so3(motion.global_orient), exp_so3(pose), motion.transl)
    parts: dict[str, np.ndarray | None] = {}
    if motion.joint_covariance is not None:
        parts["joint_covariance"] = _widened(motion.joint_covariance, motion.joint_covariance[:, _WRISTS])
        parts["joint_sigma"] = mean_sigma(parts["joint_covariance"])
    elif motion.joint_sigma is not None:
        parts["joint_sigma"] = _widened(motion.joint_sigma, motion.joint_sigma[:, _WRISTS])
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
    """Return (F, 30, 3) axis-angles of a motion's finger joints, None where it has none."""
    if not set(SMPL_HANDS.joints) <= set(motion.body_layout.joints):
        return None
    columns = [motion.body_layout.joints.index(joint) - 1 for joint in SMPL_HANDS.joints[FINGERS]]
    return motion.body_pose.reshape(motion.num_frames, -1, 3)[:, columns]


def _widened(values: np.ndarray, fingers: np.ndarray) -> np.ndarray:
    return np.concatenate([values[:, :FIRST_FINGER], fingers], axis=1)
