"""Convert recorded motions of known skeletons to SMPL joint rotations relative to the T-pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_PARENTS
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.io.units_and_axes import rotation_to_z_up


@dataclass(frozen=True)
class SkeletonMap:
    """Map from a family of skeletons to SMPL's 22 joints."""

    family: str
    joints: tuple[str, ...]  # Recorded joint that gives the global rotation of each SMPL joint 0..21.
    tpose_overrides: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    """Joints and rotation vectors (rad) of T-pose rotations that replace or complete the recorded ones."""
    halfway: tuple[tuple[int, int, int], ...] = ()
    """(joint, parent, child): SMPL joints that were not recorded. Their rotation is halfway between the other two."""


HIP_SPLAY = 0.3665  # Outward rotation of each leg in the zero pose of CMU skeletons: 21 degrees, in rad.
_ZERO_POSE = (
    ("LeftUpLeg", (0.0, 0.0, -HIP_SPLAY)),
    ("RightUpLeg", (0.0, 0.0, HIP_SPLAY)),
    ("Neck", (-0.279, 0.0, 0.0)),
    ("Neck1", (0.367, 0.0, 0.0)),
    ("Head", (0.192, 0.0, 0.0)),
    ("LeftArm", (0.0, 0.0, -0.14)),
    ("RightArm", (0.0, 0.0, 0.14)),
)
"""T-pose of CMU skeletons, for conversions that do not contain one."""
_MAX_POSE = (
    ("LeftHip", (0.0, 0.0, -HIP_SPLAY)),
    ("RightHip", (0.0, 0.0, HIP_SPLAY)),
    ("LeftShoulder", (0.0, 0.0, np.pi / 2)),
    ("RightShoulder", (0.0, 0.0, -np.pi / 2)),
)
_JUMP_POSE = (
    ("root", (0.0, -np.pi / 2, 0.0)),
    ("left_shoulder", (np.pi / 2, 0.0, 0.0)),
    ("right_shoulder", (-np.pi / 2, 0.0, 0.0)),
)
"""T-poses of two skeleton families, in rad."""
_MAKEHUMAN_POSE = tuple((s + joint, (0.0, 0.0, 0.0)) for s in ("Left", "Right") for joint in ("Hip", "Knee", "Ankle"))
_TABLE = """
    segments: Hips LeftUpLeg RightUpLeg LowerBack LeftLeg RightLeg Spine LeftFoot RightFoot Spine1 LeftToeBase
    RightToeBase Neck LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm LeftFingerBase
    RightFingerBase

    mb2: Hips LeftUpLeg RightUpLeg LowerBack LeftLeg RightLeg Spine LeftFoot RightFoot Spine1 LeftToeBase
    RightToeBase Neck LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm LeftHand RightHand

    expmap: root lfemur rfemur lowerback ltibia rtibia upperback lfoot rfoot thorax ltoes rtoes lowerneck lclavicle
    rclavicle head lhumerus rhumerus lradius rradius lhand rhand

    max: Hips LeftHip RightHip lowerback LeftKnee RightKnee Chest LeftAnkle RightAnkle Chest2 LeftToe RightToe
    lowerneck LeftCollar RightCollar Head LeftShoulder RightShoulder LeftElbow RightElbow lhand rhand

    rigify: DEF-hips DEF-thigh.L DEF-thigh.R DEF-spine.001 DEF-shin.L DEF-shin.R DEF-spine.002 DEF-foot.L DEF-foot.R
    DEF-spine.003 DEF-toe.L DEF-toe.R DEF-neck DEF-shoulder.L DEF-shoulder.R DEF-head DEF-upper_arm.L
    DEF-upper_arm.R DEF-forearm.L DEF-forearm.R DEF-hand.L DEF-hand.R

    daz: hip lThigh rThigh abdomen lShin rShin abdomen lFoot rFoot chest lFoot rFoot neck lCollar rCollar head
    lShldr rShldr lForeArm rForeArm lHand rHand

    jump: root left_hip right_hip chest left_knee right_knee chest left_ankle right_ankle chest left_ankle
    right_ankle neck chest chest neck left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist

    makehuman: Hips LeftHip RightHip Chest LeftKnee RightKnee CS_BVH LeftAnkle RightAnkle CS_BVH LeftAnkle
    RightAnkle Neck LeftCollar RightCollar Head LeftShoulder RightShoulder LeftElbow RightElbow LeftWrist RightWrist
"""
_POSES = {"segments": _ZERO_POSE, "max": _MAX_POSE, "jump": _JUMP_POSE, "makehuman": _MAKEHUMAN_POSE}
_HALFWAY = {"daz": ((3, 0, 6),), "jump": ((6, 0, 9), (3, 0, 6)), "makehuman": ((6, 3, 9),)}
MAPS: tuple[SkeletonMap, ...] = tuple(
    SkeletonMap(family, tuple(joints.split()), _POSES.get(family, ()), _HALFWAY.get(family, ()))
    for family, _, joints in (row.strip().partition(":") for row in _TABLE.split("\n\n"))
)
"""Skeleton families, tried in this order."""
_FOREARMS = tuple(zip(SMPL.both("elbow"), SMPL.both("wrist"), strict=True))
"""(elbow, wrist) joints. Forearms point along the x axis in the T-pose."""


@dataclass(frozen=True)
class RecordedClip:
    """A recorded motion of J joints in F frames, and the skeleton's T-pose."""

    name: str
    joint_names: list[str]
    parents: np.ndarray  # (J,) index of each joint's parent, -1 for the root.
    rotvec: np.ndarray  # (F, J, 3) local rotation vectors, rad.
    tpose_rotvec: np.ndarray  # (J, 3) local rotation vectors of the T-pose, rad.
    fps: float


def recorded_from_bvh(clip: BvhClip, name: str) -> RecordedClip:
    """Convert a BVH clip to Y up. Its first frame is the T-pose and is removed from the motion."""
    rotations = clip.rotations.copy()
    rotations[:, 0] = rotation_to_z_up("y").T @ rotations[:, 0]
    rotvec = log_so3(rotations)
    return RecordedClip(name, list(clip.names), clip.parents, rotvec[1:], rotvec[0], clip.fps)


def body_rotations(clip: RecordedClip) -> np.ndarray:
    """Convert a recorded motion to local rotations (F, 22, 3, 3) of SMPL joints relative to the T-pose.

    Each bone's rotation from the T-pose is ``D = G G_tpose^T`` in world axes (Y up, facing +Z, left +X, as in SMPL's
    rest pose). Local rotations are ``D_parent^T D``. The elbow receives half of the hand's twist about the forearm,
    because the radius rotates along its whole length.

    Raises:
        MotionInvalid: the joints do not belong to a known skeleton.
    """
    mapping = next((candidate for candidate in MAPS if set(candidate.joints) <= set(clip.joint_names)), None)
    if mapping is None:
        known = ", ".join(m.family for m in MAPS)
        raise MotionInvalid(f"The joints do not match a known skeleton (known: {known}).", where=clip.name)
    tpose = clip.tpose_rotvec.copy()
    for joint, rotvec in mapping.tpose_overrides:
        tpose[clip.joint_names.index(joint)] = rotvec
    index = [clip.joint_names.index(joint) for joint in mapping.joints]
    now, then = (_global_rotations(r, clip.parents)[:, index] for r in (clip.rotvec, tpose[None]))
    since = now @ np.swapaxes(then, -1, -2)
    for joint, parent, child in mapping.halfway:
        since[:, joint] = since[:, parent] @ exp_so3(0.5 * log_so3(_relative(since[:, parent], since[:, child])))
    for elbow, wrist in _FOREARMS:
        since[:, elbow] = since[:, elbow] @ _half_twist(_relative(since[:, elbow], since[:, wrist]))
    parents = list(SMPL_PARENTS[1 : 1 + NUM_BODY_JOINTS])
    return np.concatenate((since[:, :1], _relative(since[:, parents], since[:, 1:])), axis=1)


def _global_rotations(rotvec: np.ndarray, parents: np.ndarray) -> np.ndarray:
    local = exp_so3(rotvec)
    rotations: list[np.ndarray] = []
    for joint, parent in enumerate(parents):
        rotations.append(local[:, joint] if parent < 0 else rotations[int(parent)] @ local[:, joint])
    return np.stack(rotations, axis=1)


def _relative(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    return np.swapaxes(parent, -1, -2) @ child


def _half_twist(hand: np.ndarray) -> np.ndarray:
    """Return half of the twist of rotations (F, 3, 3) about the x axis (swing-twist decomposition)."""
    trace = 1.0 + np.trace(hand, axis1=-2, axis2=-1)
    twist = 2.0 * np.arctan2(hand[:, 2, 1] - hand[:, 1, 2], np.maximum(trace, 1e-9))
    return exp_so3(0.5 * twist[:, None] * np.array([1.0, 0.0, 0.0]))
