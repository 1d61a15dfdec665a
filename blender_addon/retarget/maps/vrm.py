"""VRM's humanoid: the bones that a file itself states (VRM 0.x and 1.0, VRM Consortium 2022)."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

_MIDDLE = {"hips": "pelvis", "neck": "neck_1", "head": "head"}
_SPINE = ("spine", "chest", "upperChest")
_PARTS = {
    "Shoulder": "clavicle", "UpperArm": "upper_arm", "LowerArm": "forearm", "Hand": "hand", "UpperLeg": "thigh",
    "LowerLeg": "shin", "Foot": "foot", "Toes": "toe",
}  # fmt: skip
_FINGER = re.compile(r"(left|right)(Thumb|Index|Middle|Ring|Little)(Metacarpal|Proximal|Intermediate|Distal)")
_NEEDED = {"pelvis", "head", *(f"{side}_{part}" for side in ("left", "right") for part in ("thigh", "upper_arm"))}


def roles_of_vrm(stated: Mapping[str, str], bones: Collection[str]) -> dict[str, str]:
    """Return the bone by role that a humanoid states; empty unless it states a person whose bones are there.

    A thumb's bones are called proximal, intermediate, distal in VRM 0.x and metacarpal, proximal, distal in 1.0.

    Args:
        stated: bone by VRM's name of it, such as ``leftUpperArm``.
        bones: names of the rig's bones.
    """
    there = {human: bone for human, bone in stated.items() if bone in bones}
    roles = {_MIDDLE[human]: bone for human, bone in there.items() if human in _MIDDLE}
    spine = [there[human] for human in _SPINE if human in there]
    roles |= {f"spine_{i + 1}": bone for i, bone in enumerate(spine)}
    for side in ("left", "right"):
        for word, part in _PARTS.items():
            if f"{side}{word}" in there:
                roles[f"{side}_{part}"] = there[f"{side}{word}"]
    fingers: dict[str, list[tuple[int, str]]] = {}
    for human, bone in there.items():
        if match := _FINGER.fullmatch(human):
            side, finger, segment = match.groups()
            name = f"{side}_{'pinky' if finger == 'Little' else finger.lower()}"
            rank = ("Metacarpal", "Proximal", "Intermediate", "Distal").index(segment)
            fingers.setdefault(name, []).append((rank, bone))
    for name, entries in fingers.items():
        roles |= {f"{name}_{i + 1}": bone for i, (_, bone) in enumerate(sorted(entries))}
    return roles if roles.keys() >= _NEEDED and len(set(roles.values())) == len(roles) else {}
