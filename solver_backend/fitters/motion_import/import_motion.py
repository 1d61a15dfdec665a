"""A foreign skeleton's motion as a motion of our body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_angles import informed_joints
from solver_backend.body.hands import JOINTS_OF_A_HAND, by_joint, hand_skeletons, with_fingers
from solver_backend.body.skeleton_fingers import finger_angles, finger_points, fingers_move
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.hand_points import SIDES
from solver_backend.exchange.joint_sets import NUM_JOINTS, SMPL_PARENTS
from solver_backend.exchange.rigs.skeleton import JOINT_OF
from solver_backend.fitters.hands.wide_motion import with_finger_turns
from solver_backend.fitters.motion_import.pose_fit import NUM_TURNED, deviations, fit_poses, measure
from solver_backend.fitters.motion_import.shape_from_lengths import floor_height, shape_from_lengths, standing_feet
from solver_backend.geometry.rotations import log_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Motion, SkeletonMotion

_ARMS = tuple(zip(*map(SMPL.both, ("elbow", "wrist", "hand")), strict=True))
"""Elbow, wrist and hand of each arm."""


@dataclass(frozen=True)
class ImportedMotion:
    """A motion on our body, and its distance from the source."""

    motion: Motion
    distances_mm: dict[str, float]
    """Root mean square distance of each joint from the skeleton's, by role."""
    raised_m: float
    """Height by which the motion was raised for the soles to stand on the floor."""


def import_motion(
    source: SkeletonMotion, roles: dict[str, str], body: Body, *, keep_height: bool = False
) -> ImportedMotion:
    """Return the motion of a skeleton on our body, with the shape of its bones' lengths, and its fingers if they move.

    Args:
        roles: the skeleton's joint by role.
        body: with SMPL's joints first.
        keep_height: leave the motion at the clip's height; its lowest soles stand at z = 0 otherwise.

    Raises:
        MotionInvalid: left and right are not known.
    """
    measured = measure(source, roles, body.rest_joints(np.zeros(10))[:NUM_JOINTS])
    betas = shape_from_lengths(body, measured.rest)
    rest = body.rest_joints(betas)[:NUM_JOINTS]
    G, joints = fit_poses(rest, measured)
    off = 1000.0 * np.sqrt(((joints - measured.places) ** 2).sum(-1).mean(0))
    sigma, resting = deviations(joints, measured.places), _resting(measured.places)
    raised = 0.0 if keep_height else -floor_height(body, betas, joints)
    joints = joints + [0.0, 0.0, raised]
    parents = list(SMPL_PARENTS[1:NUM_TURNED])
    local = np.swapaxes(G[:, parents], -1, -2) @ G[:, 1:]
    pose = np.zeros((source.num_frames, NUM_JOINTS - 1, 3))
    pose[:, : NUM_TURNED - 1] = log_so3(local)
    motion = Motion(
        betas=betas,
        global_orient=log_so3(G[:, 0]),
        body_pose=pose.reshape(len(pose), -1),
        transl=joints[:, 0] - rest[0],
        fps=source.fps,
        body=body.id,
        joints=joints,
        contacts=standing_feet(body, betas, joints, source.fps),
        joint_sigma=sigma,
        resting=resting,
        provenance={"source": source.name, "method": "motion import", "roles": roles},
    )
    motion = _with_own_fingers(motion, body, source, roles)
    distances = {role: float(off[joint]) for role, joint in JOINT_OF.items() if np.isfinite(off[joint])}
    return ImportedMotion(motion, distances, raised)


def _with_own_fingers(motion: Motion, body: Body, source: SkeletonMotion, roles: dict[str, str]) -> Motion:
    """Return the motion with the skeleton's fingers, where they ever turn and the body has finger joints."""
    moving = [side for side in range(len(SIDES)) if fingers_move(source, roles, side)]
    try:
        fingered = with_fingers(body)
    except BodyInvalid:
        return motion
    shape = (motion.num_frames, len(SIDES), JOINTS_OF_A_HAND)
    turns, resting, prior = np.zeros((*shape, 3)), np.ones(shape, bool), load_hand_prior()
    for side, skeleton in enumerate(hand_skeletons(fingered)):
        points = finger_points(source, roles, side) if side in moving else None
        if points is not None:
            angles = finger_angles(points, side)[0]
            turns[:, side] = log_so3(by_joint(skeleton.local_rotations(prior.completed(angles))))
            resting[:, side] = by_joint(~informed_joints(np.isfinite(angles)))
    if resting.all():
        return motion
    flat = (motion.num_frames, len(SIDES) * JOINTS_OF_A_HAND)
    return with_finger_turns(motion, body, turns.reshape(*flat, 3), resting.reshape(flat))


def _resting(places: np.ndarray) -> np.ndarray | None:
    """Return (F, 24) the joints that nothing shows, elbows, wrists and hands of missing arms; or None."""
    unknown = np.isnan(places[0, :, 0])
    resting = np.zeros(places.shape[:2], dtype=bool)
    for elbow, wrist, hand in _ARMS:
        resting[:, elbow], resting[:, [wrist, hand]] = unknown[elbow], unknown[wrist]
    return resting if resting.any() else None
