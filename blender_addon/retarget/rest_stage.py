"""Convert a rig at rest to stage coordinates: find up, forward and the height of the soles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import bpy
import numpy as np
from mathutils import Matrix

from .._exchange.rigs.rest_frames import stage_axes
from .._exchange.rigs.skeleton import FINGERS, LIMBS, SIDES, chain_roles
from ..body.mesh import positions
from ..errors import MapInvalid
from .hanging import Hanging, bone_rotations
from .motion.figures import Target, by_part, part_of_role


def _skin_points(armature: bpy.types.Object, bones: set[str], centre: np.ndarray, radius: float) -> np.ndarray:
    """Return (V, 3) rest vertices that mainly follow the given bones and are within a radius of a point."""
    found = [np.zeros((0, 3))]
    for mesh, placed, holder in _meshes(armature):
        near = np.flatnonzero(np.linalg.norm(placed - centre, axis=1) < radius)
        if not holder:
            chosen = {group.index for group in mesh.vertex_groups if group.name in bones}
            near = [v for v in near if heaviest(mesh.data.vertices[int(v)]) in chosen] if chosen else []
        elif holder not in bones:
            continue
        found.append(placed[near])
    return np.concatenate(found)


def _skin_by_bone(armature: bpy.types.Object, most: int) -> Iterator[tuple[np.ndarray, list[str]]]:
    """Yield up to ``most`` vertices (V, 3) of each mesh, and the bone that each vertex follows."""
    for mesh, placed, holder in _meshes(armature):
        vertices, names = mesh.data.vertices, {group.index: group.name for group in mesh.vertex_groups}
        chosen = range(0, len(vertices), 1 + len(vertices) // most)
        yield placed[list(chosen)], [holder or names.get(heaviest(vertices[v]), "") for v in chosen]


def _meshes(armature: bpy.types.Object) -> Iterator[tuple[bpy.types.Object, np.ndarray, str]]:
    """Yield each mesh of an armature with its rest vertices (V, 3), and its parent bone or "" if it is skinned."""
    for obj in bpy.data.objects:
        if obj.type != "MESH":
            continue
        if obj.parent == armature and obj.parent_type == "BONE" and obj.parent_bone in armature.data.bones:
            bone = armature.data.bones[obj.parent_bone]
            # Blender measures child objects of a bone from its tail.
            tail = bone.matrix_local @ Matrix.Translation((0.0, bone.length, 0.0))
            place, holder = tail @ obj.matrix_parent_inverse @ obj.matrix_basis, bone.name
        elif any(m.type == "ARMATURE" and m.object == armature for m in obj.modifiers) or (
            obj.parent == armature and obj.parent_type == "ARMATURE"
        ):
            place, holder = armature.matrix_world.inverted() @ obj.matrix_world, ""
        else:
            continue
        M = np.array(place)
        yield obj, positions(obj.data.vertices) @ M[:3, :3].T + M[:3, 3], holder


def heaviest(vertex: bpy.types.MeshVertex) -> int:
    """Return the index of the vertex group with a vertex's largest weight, or -1 if it has no groups."""
    return max(vertex.groups, key=lambda entry: entry.weight).group if len(vertex.groups) else -1


_NEAR = 0.05  # A bone closer than this to the ankle, relative to the shin, belongs to the foot.
_SOLE_SHARE = 0.095
"""Height of the ankle above the sole, relative to the leg length, if no skin shows it. ANSUR II has 0.08 for the
malleolus of a bare foot, and the sole of a shoe adds to that."""
_BELOW_BALL = 0.02  # Smallest height of the toe joint above the sole, relative to the leg length.
_LIKELY_SOLE = (0.01, 0.45)
"""Plausible ankle heights above the sole, relative to the leg length. 0.45 is a platform shoe with a high heel."""
_LIKELY_END = (0.08, 0.9)  # Plausible lengths of a hand or foot, relative to the forearm or shin.


def _measure_sole(armature: bpy.types.Object, leg: dict[str, str], heads: np.ndarray, up: np.ndarray) -> float | None:
    """Return the height of a foot's lowest skin along ``up`` (3,), or None if no plausible skin is found."""
    shin, reach = (float(np.linalg.norm(heads[k + 1] - heads[k])) for k in (1, 0))
    bones = _bones_of_foot(armature, leg, _NEAR * shin)
    points = _skin_points(armature, bones, heads[2], shin)
    if not len(points):
        return None
    sole = float((points @ up).min())
    low, high = _LIKELY_SOLE
    return sole if low <= (heads[2] @ up - sole) / (shin + reach) <= high else None


def _estimate_sole(heads: np.ndarray, toe: np.ndarray | None, up: np.ndarray) -> float:
    leg = float(np.linalg.norm(np.diff(heads, axis=0), axis=1).sum())
    below_ankle = heads[2] @ up - _SOLE_SHARE * leg
    return float(below_ankle if toe is None else min(below_ankle, toe @ up - _BELOW_BALL * leg))


def _end_of(armature: bpy.types.Object, bones: dict[str, str], role: str, before: float) -> np.ndarray:
    """Return the (3,) end of a hand or foot, or NaN if it is unknown.

    A hand ends at the knuckle of the middle finger, or else at the mean of all knuckles. A foot ends at its toe bone.
    ``bones`` maps roles to bones, including fingers. ``before`` is the length of the forearm or shin.
    """
    side, _, part = role.partition("_")
    knuckle = f"{side}_middle_1"
    knuckles = [knuckle] if knuckle in bones else [f"{side}_{finger}_1" for finger in FINGERS[1:]]
    roles = [f"{side}_toe"] if part == "foot" else knuckles
    data, start = armature.data.bones, np.array(armature.data.bones[bones[role]].head_local, np.float64)
    named = [np.array(data[bones[other]].head_local, np.float64) for other in roles if other in bones]
    if named:
        return np.mean(named, axis=0)
    low, high = _LIKELY_END
    below = np.array([child.head_local for child in data[bones[role]].children], np.float64).reshape(-1, 3)
    far = np.linalg.norm(below - start, axis=1)
    below = below[(far > low * before) & (far < high * before)]
    return below.mean(0) if len(below) else np.full(3, np.nan)


def _legs_of(bones: dict[str, str]) -> list[dict[str, str]]:
    parts = ("thigh", "shin", "foot", "toe")
    legs = [{part: bones[f"{side}_{part}"] for part in parts if f"{side}_{part}" in bones} for side in SIDES]
    return [leg for leg in legs if {"thigh", "shin", "foot"} <= leg.keys()]


def _bones_of_foot(armature: bpy.types.Object, leg: dict[str, str], near: float) -> set[str]:
    data = armature.data.bones
    starts = [data[leg[part]].head_local for part in ("foot", "toe") if part in leg]
    seeds = {leg["foot"], leg.get("toe", leg["foot"])}
    seeds |= {bone.name for bone in data if any((bone.head_local - start).length < near for start in starts)}
    return {below.name for seed in seeds for below in (data[seed], *data[seed].children_recursive)}


_MOST = 6000  # Largest number of vertices used per mesh, about ten per table cell.
_ON_ROD = 0.01  # Largest distance between a bone's head and a limb, relative to the figure's height.
_BEFORE_END = 0.95  # Largest relative position along the limb. Bones at its end belong to the next part.
_ENDS = ("hand", "foot", "toe")  # Parts with bones, but without contacts of hands.


def _skin_by_part(armature: bpy.types.Object, bones: dict[str, str]) -> dict[str, np.ndarray]:
    """Return rest vertices (V, 3) for each body part, in the armature's space.

    A vertex belongs to the part of the bone that it mainly follows. A bone's part comes from its role, from the limb
    that it starts on (twist helpers, deform bones of a control rig), or from its parent. ``bones`` maps roles to bones.
    """
    parts = _parts_of_bones(armature, bones)
    found: dict[str, list[np.ndarray]] = {}
    for points, names in _skin_by_bone(armature, _MOST):
        for part, own in by_part(points, np.array([parts.get(name, "") for name in names])).items():
            found.setdefault(part, []).append(own)
    return {part: np.concatenate(pieces) for part, pieces in found.items()}


def _parts_of_bones(armature: bpy.types.Object, bones: dict[str, str]) -> dict[str, str]:
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
    """Return the part, start and end of each limb and trunk segment.

    Hands, feet and toes are added as points that belong to no part ("").
    """
    trunk = ["pelvis", *chain_roles(dict.fromkeys(heads, ""), "spine"), "neck_1"]
    lines = [("trunk", a, b) for a, b in pairwise(trunk)]
    for side in ("left", "right"):
        for start, end in (("thigh", "shin"), ("shin", "foot"), ("upper_arm", "forearm"), ("forearm", "hand")):
            lines.append((f"{side}_{start}", f"{side}_{start}", f"{side}_{end}"))
        lines += [("", f"{side}_{end}", f"{side}_{end}") for end in _ENDS]
    return [(part, heads[a], heads[b]) for part, a, b in lines if a in heads and b in heads]


def _nearest(head: np.ndarray, rods: list[tuple[str, np.ndarray, np.ndarray]], within: float) -> str | None:
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


_NEAR_FLOOR = 0.035
"""Largest height of the armature's origin above the floor if there is no skin, relative to the figure's height."""


def stand_on_stage(
    armature: bpy.types.Object, hanging: Hanging, roles: tuple[str, ...], bones: dict[str, str], unit_m: float
) -> tuple[Target, str]:
    """Return the rig with its soles at z = 0 and facing -Y, and the source of the sole height (mesh or joints).

    A mirrored armature remains mirrored, so that its right limbs are the left ones in stage coordinates. Raises
    ``MapInvalid`` if the map does not distinguish left and right.
    """
    heads = hanging.matrices[:, :3, 3]
    R = stage_axes(dict(zip(roles, heads, strict=True)))
    if R is None:
        hint = "Map both thighs or both upper arms, so that left and right are known."
        raise MapInvalid("The map does not define the left and right sides of the rig.", hint=hint)
    mirrored = armature.matrix_world.determinant() < 0
    if mirrored:
        R, roles = np.diag([-1.0, 1.0, 1.0]) @ R, tuple(_other_side(role) for role in roles)
    ends = np.array([_end(armature, heads, bones, hanging.names, c) for c in range(len(roles))])
    axes = R @ bone_rotations(hanging.matrices)
    own = np.array([armature.data.bones[name].use_local_location for name in hanging.names])[:, None, None]
    rest = unit_m * heads @ R.T, unit_m * ends @ R.T, axes, np.where(own, axes, R)
    target = Target(hanging.names, roles, *rest, hanging.turns_with, hanging.moves_with, R, unit_m, np.zeros(3))
    sole, shown_by = _sole(armature, bones, R[2])
    ground = np.array([0.0, 0.0, unit_m * sole])
    skin = {
        _other_side(part) if mirrored else part: unit_m * points @ R.T - ground
        for part, points in _skin_by_part(armature, bones).items()
    }
    standing = replace(target, heads=target.heads - ground, ends=target.ends - ground, ground=ground, skin=skin)
    return standing, shown_by


def stand_in_pose(
    names: tuple[str, ...], roles: tuple[str, ...], matrices: np.ndarray, R: np.ndarray, m: float
) -> Target:
    """Return a rest pose in stage coordinates from bone matrices (N, 4, 4) of a frame with an upright figure.

    Args:
        R: (3, 3) rotation from the armature's axes to the stage's.
        m: metres per unit of the armature's space.
    """
    axes, nobody = R @ bone_rotations(matrices), np.full(len(names), -1)
    heads = m * matrices[:, :3, 3] @ R.T
    at = dict(zip(roles, heads, strict=True))
    ends = np.full_like(heads, np.nan)
    for c, role in enumerate(roles):
        side, _, part = role.partition("_")
        tips = [f"{side}_toe"] if part == "foot" else [f"{side}_{f}_1" for f in FINGERS[1:]] if part == "hand" else []
        if known := [at[tip] for tip in tips if tip in at]:
            ends[c] = np.mean(known, axis=0)
    legs = [[f"{side}_{part}" for part in ("thigh", "shin", "foot", "toe")] for side in SIDES]
    whole = [leg for leg in legs if set(leg[:3]) <= at.keys()]
    soles = [_estimate_sole(np.stack([at[role] for role in leg[:3]]), at.get(leg[3]), np.eye(3)[2]) for leg in whole]
    ground = np.array([0.0, 0.0, min(soles, default=0.0)])
    return Target(names, roles, heads - ground, ends - ground, axes, axes, nobody, nobody, R, m, ground)


def _sole(armature: bpy.types.Object, bones: dict[str, str], up: np.ndarray) -> tuple[float, str]:
    data, legs = armature.data.bones, _legs_of(bones)
    if not legs:
        return 0.0, "joints"
    placed = [{part: np.array(data[name].head_local, np.float64) for part, name in leg.items()} for leg in legs]
    joints = [np.stack([heads[part] for part in ("thigh", "shin", "foot")]) for heads in placed]
    measured = [_measure_sole(armature, leg, heads, up) for leg, heads in zip(legs, joints, strict=True)]
    if shown := [sole for sole in measured if sole is not None]:
        return min(shown), "mesh"
    low = min(_estimate_sole(heads, places.get("toe"), up) for heads, places in zip(joints, placed, strict=True))
    height = max(np.array(bone.head_local, np.float64) @ up for bone in data) - low
    return (0.0 if abs(low) < _NEAR_FLOOR * height else low), "joints"


def _end(
    armature: bpy.types.Object, heads: np.ndarray, bones: dict[str, str], names: tuple[str, ...], control: int
) -> np.ndarray:
    role = next(role for role, bone in bones.items() if bone == names[control])
    limb = next((roles for roles in LIMBS.values() if roles[-1] == role and set(roles) <= bones.keys()), None)
    if limb is None:
        return np.full(3, np.nan)
    lower = heads[names.index(bones[limb[1]])]
    return _end_of(armature, bones, role, float(np.linalg.norm(heads[control] - lower)))


def _other_side(role: str) -> str:
    for side, other in (SIDES, SIDES[::-1]):
        if role.startswith(f"{side}_"):
            return other + role.removeprefix(side)
    return role
