"""Which joint of each family of recordings turns with which of the 21 SMPL body joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.errors import MotionInvalid


@dataclass(frozen=True)
class SkeletonMap:
    """How a recorded skeleton's joints correspond to SMPL's 22 (pelvis and 21 body joints)."""

    family: str
    joints: tuple[str, ...]
    """Recorded joint whose global rotation each of SMPL's joints 0..21 takes."""
    tpose_overrides: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    """Rotation vectors (rad) of the T-pose that replace or complete the recorded one."""
    halfway: tuple[tuple[int, int, int], ...] = ()
    """(joint, parent, child): SMPL joints the recording lacks, which turn halfway between two others."""

    def indices(self, names: list[str]) -> list[int]:
        """Return the recorded index of each SMPL joint."""
        return [names.index(joint) for joint in self.joints]


HIP_SPLAY = 0.3665
"""rad, by which the legs of the CMU skeletons' zero pose are spread (21 degrees)."""

_ZERO_POSE = (
    ("LeftUpLeg", (0.0, 0.0, -HIP_SPLAY)), ("RightUpLeg", (0.0, 0.0, HIP_SPLAY)), ("Neck", (-0.279, 0.0, 0.0)),
    ("Neck1", (0.367, 0.0, 0.0)), ("Head", (0.192, 0.0, 0.0)), ("LeftArm", (0.0, 0.0, -0.14)),
    ("RightArm", (0.0, 0.0, 0.14)),
)  # fmt: skip
"""The T-pose of CMU's skeletons as the other conversions hold it, where a conversion does not."""

MAPS: tuple[SkeletonMap, ...] = (
    SkeletonMap(
        "segments",
        (
            "Hips", "LeftUpLeg", "RightUpLeg", "LowerBack", "LeftLeg", "RightLeg", "Spine", "LeftFoot",
            "RightFoot", "Spine1", "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder",
            "Head", "LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftFingerBase", "RightFingerBase",
        ),
        _ZERO_POSE,
    ),
    SkeletonMap(
        "mb2",
        (
            "Hips", "LeftUpLeg", "RightUpLeg", "LowerBack", "LeftLeg", "RightLeg", "Spine", "LeftFoot",
            "RightFoot", "Spine1", "LeftToeBase", "RightToeBase", "Neck", "LeftShoulder", "RightShoulder",
            "Head", "LeftArm", "RightArm", "LeftForeArm", "RightForeArm", "LeftHand", "RightHand",
        ),
    ),
    SkeletonMap(
        "expmap",
        (
            "root", "lfemur", "rfemur", "lowerback", "ltibia", "rtibia", "upperback", "lfoot", "rfoot", "thorax",
            "ltoes", "rtoes", "lowerneck", "lclavicle", "rclavicle", "head", "lhumerus", "rhumerus", "lradius",
            "rradius", "lhand", "rhand",
        ),
    ),
    SkeletonMap(
        "max",
        (
            "Hips", "LeftHip", "RightHip", "lowerback", "LeftKnee", "RightKnee", "Chest", "LeftAnkle",
            "RightAnkle", "Chest2", "LeftToe", "RightToe", "lowerneck", "LeftCollar", "RightCollar", "Head",
            "LeftShoulder", "RightShoulder", "LeftElbow", "RightElbow", "lhand", "rhand",
        ),
        (
            ("LeftHip", (0.0, 0.0, -HIP_SPLAY)),
            ("RightHip", (0.0, 0.0, HIP_SPLAY)),
            ("LeftShoulder", (0.0, 0.0, np.pi / 2)),
            ("RightShoulder", (0.0, 0.0, -np.pi / 2)),
        ),
    ),
    SkeletonMap(
        "rigify",
        (
            "DEF-hips", "DEF-thigh.L", "DEF-thigh.R", "DEF-spine.001", "DEF-shin.L", "DEF-shin.R", "DEF-spine.002",
            "DEF-foot.L", "DEF-foot.R", "DEF-spine.003", "DEF-toe.L", "DEF-toe.R", "DEF-neck", "DEF-shoulder.L",
            "DEF-shoulder.R", "DEF-head", "DEF-upper_arm.L", "DEF-upper_arm.R", "DEF-forearm.L", "DEF-forearm.R",
            "DEF-hand.L", "DEF-hand.R",
        ),
    ),
    SkeletonMap(
        "daz",
        (
            "hip", "lThigh", "rThigh", "abdomen", "lShin", "rShin", "abdomen", "lFoot", "rFoot", "chest", "lFoot",
            "rFoot", "neck", "lCollar", "rCollar", "head", "lShldr", "rShldr", "lForeArm", "rForeArm", "lHand",
            "rHand",
        ),
        halfway=((3, 0, 6),),
    ),
    SkeletonMap(
        "jump",
        (
            "root", "left_hip", "right_hip", "chest", "left_knee", "right_knee", "chest", "left_ankle",
            "right_ankle", "chest", "left_ankle", "right_ankle", "neck", "chest", "chest", "neck",
            "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
        ),
        (
            ("root", (0.0, -np.pi / 2, 0.0)), ("left_shoulder", (np.pi / 2, 0.0, 0.0)),
            ("right_shoulder", (-np.pi / 2, 0.0, 0.0)),
        ),
        halfway=((6, 0, 9), (3, 0, 6)),
    ),
    SkeletonMap(
        "makehuman",
        (
            "Hips", "LeftHip", "RightHip", "Chest", "LeftKnee", "RightKnee", "CS_BVH", "LeftAnkle", "RightAnkle",
            "CS_BVH", "LeftAnkle", "RightAnkle", "Neck", "LeftCollar", "RightCollar", "Head", "LeftShoulder",
            "RightShoulder", "LeftElbow", "RightElbow", "LeftWrist", "RightWrist",
        ),
        tuple(
            (side + joint, (0.0, 0.0, 0.0)) for side in ("Left", "Right") for joint in ("Hip", "Knee", "Ankle")
        ),
        halfway=((6, 3, 9),),
    ),
)  # fmt: skip


def skeleton_map(names: list[str], where: str = "") -> SkeletonMap:
    """Return the map whose joints are all among ``names``.

    Raises:
        MotionInvalid: no known family of recordings has these joints.
    """
    for candidate in MAPS:
        if set(candidate.joints) <= set(names):
            return candidate
    known = ", ".join(m.family for m in MAPS)
    raise MotionInvalid(f"The joints belong to no known skeleton (known: {known}).", where=where)
