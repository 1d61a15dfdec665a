"""Joints of bodies and the humanoid bones of Unity (``HumanBodyBones``) that stand for them."""

from __future__ import annotations

_FINGERS = {"thumb": "Thumb", "index": "Index", "middle": "Middle", "ring": "Ring", "pinky": "Little"}
_KNUCKLES = ("Proximal", "Intermediate", "Distal")
_OF_A_SIDE = {
    "hip": "UpperLeg", "knee": "LowerLeg", "ankle": "Foot", "foot": "Toes", "collar": "Shoulder",
    "shoulder": "UpperArm", "elbow": "LowerArm", "wrist": "Hand",
    **{f"{ours}{k + 1}": f"{unity}{part}" for ours, unity in _FINGERS.items() for k, part in enumerate(_KNUCKLES)},
}  # fmt: skip
BONE_OF = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Chest", "spine3": "UpperChest", "neck": "Neck", "head": "Head",
    "jaw": "Jaw", "left_eye": "LeftEye", "right_eye": "RightEye",
    **{
        f"{side}_{joint}": f"{side.capitalize()}{bone}"
        for joint, bone in _OF_A_SIDE.items() for side in ("left", "right")
    },
}  # fmt: skip
"""Unity's bone of each joint of the SMPL family; SMPL's hand joints, the knuckles of flat hands, have none."""
JOINT_OF = {bone: joint for joint, bone in BONE_OF.items()}
