"""Our body's joints as a character of another program: Mixamo's names, the body's own proportions."""

from __future__ import annotations

import numpy as np

from blender_addon._exchange.finger_joints import FIRST_FINGER
from blender_addon.body.body_file import BodyFile
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from blender_addon.conventions.skeleton import SMPL
from tests.support.foreign_skeletons import ForeignSkeleton

_ROLES = {
    "Hips": "pelvis", "LeftUpLeg": "left_thigh", "RightUpLeg": "right_thigh", "Spine": "spine_1",
    "LeftLeg": "left_shin", "RightLeg": "right_shin", "Spine1": "spine_2", "LeftFoot": "left_foot",
    "RightFoot": "right_foot", "Spine2": "spine_3", "LeftToeBase": "left_toe", "RightToeBase": "right_toe",
    "Neck": "neck_1", "LeftShoulder": "left_clavicle", "RightShoulder": "right_clavicle", "Head": "head",
    "LeftArm": "left_upper_arm", "RightArm": "right_upper_arm", "LeftForeArm": "left_forearm",
    "RightForeArm": "right_forearm", "LeftHand": "left_hand", "RightHand": "right_hand",
    "LeftHandMiddle1": "left_middle_1", "RightHandMiddle1": "right_middle_1",
}  # fmt: skip
"""Role by name, in the order of SMPL's joints."""


def _roles(body: BodyFile) -> dict[str, str]:
    """Return the role of each bone by its name, in the order of the body's joints."""
    if body.layout is SMPL:
        return _ROLES
    roles = dict(list(_ROLES.items())[:FIRST_FINGER])
    for joint in body.layout.joints[FIRST_FINGER:]:
        side, _, finger = joint.partition("_")
        roles[f"{side.title()}Hand{finger.title()}"] = f"{joint[:-1]}_{joint[-1]}"
    return roles


def own_skeleton(body: BodyFile, betas: np.ndarray, prefix: str = "mixamorig:") -> ForeignSkeleton:
    """Return the joints of a shape at rest, soles on the floor; with the fingers of a body that has some."""
    joints = body.rest_joints(betas) @ R_ARMATURE_BODY.T
    joints = joints - [0.0, 0.0, (body.shaped(betas) @ R_ARMATURE_BODY.T)[:, 2].min()]
    names = [prefix + name for name in _roles(body)]
    parents = {names[j]: names[p] for j, p in enumerate(body.layout.parents) if p >= 0}
    roles = {role: prefix + name for name, role in _roles(body).items()}
    return ForeignSkeleton(dict(zip(names, joints, strict=True)), parents, roles)
