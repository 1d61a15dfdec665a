"""Roles: what a bone of any rig is on a person, and which joint of ours moves it."""

from __future__ import annotations

import re

from ..body_layout import SMPL

SIDES = ("left", "right")
CHAINS = ("spine", "neck")
"""Parts of several bones: ``spine_1`` is the lowest."""
_OF_A_SIDE = {
    "clavicle": SMPL.both("collar"), "upper_arm": SMPL.both("shoulder"), "forearm": SMPL.both("elbow"),
    "hand": SMPL.both("wrist"), "thigh": SMPL.both("hip"), "shin": SMPL.both("knee"), "foot": SMPL.both("ankle"),
    "toe": SMPL.both("foot"),
}  # fmt: skip
"""The left and the right joint that turns each bone of a side."""
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
"""Fingers of a hand: ``left_index_1`` is the bone next to the knuckle, bones of the palm have no role."""
JOINT_OF = {
    **dict(zip(("pelvis", "head"), SMPL.numbers("pelvis", "head"), strict=True)),
    **{f"{side}_{part}": pair[s] for part, pair in _OF_A_SIDE.items() for s, side in enumerate(SIDES)},
}  # fmt: skip
"""The joint of SMPL's tree that turns each role's bone; spine and neck lie between joints."""
HELPER_OF = {
    "hand_ik": ("hand", "hand"), "foot_ik": ("foot", "foot"), "toe_ik": ("toe", "toe"),
    "elbow_pole": ("upper_arm", "forearm"), "knee_pole": ("thigh", "shin"),
}  # fmt: skip
"""Controls of a side that pose an IK limb: the part they turn with and the one at whose head they stand."""
LIMB_OF_POLE = {"elbow_pole": "arm", "knee_pole": "leg"}
LIMBS = {
    f"{side}_{name}": (f"{side}_{upper}", f"{side}_{lower}", f"{side}_{end}")
    for name, (upper, lower, end) in {"arm": ("upper_arm", "forearm", "hand"), "leg": ("thigh", "shin", "foot")}.items()
    for side in SIDES
}
"""Upper bone, lower bone and end of the limbs with one hinge."""
_KNOWN = re.compile(
    rf"root|carrier|pelvis|head|({'|'.join(CHAINS)})_[1-9]\d?"
    rf"|({'|'.join(SIDES)})_({'|'.join((*_OF_A_SIDE, *HELPER_OF))}|({'|'.join(FINGERS)})_[1-4])"
)


def is_role(name: str) -> bool:
    """Return whether this is a role; the carrier moves the whole body and may be the pelvis itself."""
    return _KNOWN.fullmatch(name) is not None


def is_of_a_side(part: str) -> bool:
    """Return whether a part of the body has a left and a right."""
    return part in _OF_A_SIDE or part in HELPER_OF


def is_of_a_finger(role: str) -> bool:
    """Return whether a role is a bone of a finger."""
    return role.rstrip("1234").rstrip("_").rpartition("_")[2] in FINGERS


def chain_roles(bones: dict[str, str], chain: str) -> list[str]:
    """Return the roles of a chain that have a bone, from the pelvis up."""
    found = (role for role in bones if role.startswith(f"{chain}_"))
    return sorted(found, key=lambda role: int(role.rpartition("_")[2]))


def order_of(role: str) -> tuple[int, str]:
    """Return where a role stands in a list that people read: trunk, arms, legs, helpers."""
    part = re.sub(r"^(left|right)_|_\d+$", "", role)
    parts = ("root", "carrier", "pelvis", "spine", "neck", "head", *_OF_A_SIDE, *FINGERS, *HELPER_OF)
    return parts.index(part), role
