"""The skin of any rig by part of the body, for hands that touch it."""

from __future__ import annotations

from itertools import pairwise

import bpy
import numpy as np

from .._exchange.rigs.roles import chain_roles
from .motion.parts import by_part, part_of_role
from .skin import skin_by_bone

_MOST = 6000
"""Vertices of a mesh that are looked at: a cell of a part's table of radii then has some ten."""
_ON_ROD = 0.01
"""Share of the figure's height within which a bone that has no role begins on another's way to its child."""
_BEFORE_END = 0.95
"""Share of that way up to which it does: what begins at its end is the next part's."""
_ENDS = ("hand", "foot", "toe")
"""Parts that hands are not kept on but that bones begin at."""


def skin_by_part(armature: bpy.types.Object, bones: dict[str, str]) -> dict[str, np.ndarray]:
    """Return the (V, 3) vertices at rest by part of the body, in the armature's space.

    A vertex belongs to the part of the bone that it follows most: by that bone's role, else by the limb on which it
    begins (helpers of twist, bones of a rig of controls that deform), else by its parent.

    Args:
        armature: the rig.
        bones: by role.
    """
    parts = _parts_of_bones(armature, bones)
    found: dict[str, list[np.ndarray]] = {}
    for points, names in skin_by_bone(armature, _MOST):
        for part, own in by_part(points, np.array([parts.get(name, "") for name in names])).items():
            found.setdefault(part, []).append(own)
    return {part: np.concatenate(pieces) for part, pieces in found.items()}


def _parts_of_bones(armature: bpy.types.Object, bones: dict[str, str]) -> dict[str, str]:
    """Return the part of each bone of an armature, "" for none."""
    data, role_of = armature.data.bones, {bone: role for role, bone in bones.items()}
    heads = {role: np.array(data[bone].head_local, np.float64) for role, bone in bones.items() if bone in data}
    rods = _rods(heads)
    height = float(np.ptp([bone.head_local for bone in data], axis=0).max())
    parts: dict[str, str] = {}
    for bone in data:  # parents come before their children
        if bone.name in role_of:
            parts[bone.name] = part_of_role(role_of[bone.name])
            continue
        near = _nearest(np.array(bone.head_local, np.float64), rods, _ON_ROD * height)
        parts[bone.name] = near if near is not None else parts.get(bone.parent.name, "") if bone.parent else ""
    return parts


def _rods(heads: dict[str, np.ndarray]) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return part, beginning and end of each limb and of the trunk's line; of hands and feet where they begin."""
    trunk = ["pelvis", *chain_roles(dict.fromkeys(heads, ""), "spine"), "neck_1"]
    lines = [("trunk", a, b) for a, b in pairwise(trunk)]
    for side in ("left", "right"):
        for start, end in (("thigh", "shin"), ("shin", "foot"), ("upper_arm", "forearm"), ("forearm", "hand")):
            lines.append((f"{side}_{start}", f"{side}_{start}", f"{side}_{end}"))
        lines += [("", f"{side}_{end}", f"{side}_{end}") for end in _ENDS]
    return [(part, heads[a], heads[b]) for part, a, b in lines if a in heads and b in heads]


def _nearest(head: np.ndarray, rods: list[tuple[str, np.ndarray, np.ndarray]], within: float) -> str | None:
    """Return the part of the nearest rod that a place lies on, None where it lies on none."""
    found, least = None, within
    for part, start, end in rods:
        way = end - start
        share = float((head - start) @ way) / max(float(way @ way), 1e-12)
        if share > _BEFORE_END:
            continue
        distance = float(np.linalg.norm(head - start - np.clip(share, 0.0, 1.0) * way))
        if distance < least:
            found, least = part, distance
    return found
