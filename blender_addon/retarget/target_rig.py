"""Read a target rig: the roles that can be animated, and its rest pose in stage coordinates."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import bpy
import numpy as np

from .._exchange.rigs.skeleton import HELPER_OF, JOINT_OF, LIMBS, is_of_a_finger
from ..conventions.coordinates import even_scale
from ..errors import MapInvalid, TargetUnsuitable
from .hanging import Hanging, hanging_of
from .motion.figures import Target
from .rest_stage import stand_on_stage
from .rig_map import RigMap


def _constraint_ring(armature: bpy.types.Object) -> list[str]:
    waits: dict[str, set[str]] = defaultdict(set)
    for bone in armature.pose.bones:
        if bone.parent is not None:
            waits[bone.name].add(bone.parent.name)
        for constraint in bone.constraints:
            if constraint.mute or constraint.influence == 0.0:
                continue
            bent = _chain(bone, constraint.chain_count) if constraint.type in ("IK", "SPLINE_IK") else [bone.name]
            for name in bent:
                waits[name] |= {other for other in _targets(constraint, armature) if other}
    return _ring_in(waits)


def _object_ring(obj: bpy.types.Object) -> list[str]:
    waits: dict[str, set[str]] = {}
    todo = [obj]
    while todo:
        one = todo.pop()
        if one.name_full in waits:
            continue
        others = [c.target for c in one.constraints if not c.mute and getattr(c, "target", None) is not None]
        others += [one.parent] if one.parent is not None else []
        waits[one.name_full] = {other.name_full for other in others}
        todo += others
    return _ring_in(waits)


def _ring_in(waits: Mapping[str, set[str]]) -> list[str]:
    try:
        TopologicalSorter(waits).prepare()
    except CycleError as ring:
        return list(ring.args[1])
    return []


def _targets(constraint: bpy.types.Constraint, armature: bpy.types.Object) -> set[str]:
    found = set()
    for holder, name in (("target", "subtarget"), ("pole_target", "pole_subtarget")):
        if getattr(constraint, holder, None) == armature:
            found.add(getattr(constraint, name, ""))
    if constraint.type == "ARMATURE":
        found |= {target.subtarget for target in constraint.targets if target.target == armature}
    return found


def _chain(bone: bpy.types.PoseBone, count: int) -> list[str]:
    chain = [bone.name]
    while bone.parent is not None and (count == 0 or len(chain) < count):
        bone = bone.parent
        chain.append(bone.name)
    return chain


@dataclass(frozen=True)
class TargetRig:
    """A rig that receives a motion, with its rest pose, switches and notes."""

    armature: bpy.types.Object
    target: Target
    switches: dict[tuple[str, str], float]  # Values of custom properties, given by (bone, key), for the chosen limbs.
    modes: dict[str, str]  # Rotation modes of the controls.
    soles: str  # How the sole height was found: ``mesh`` or ``joints``.
    notes: tuple[str, ...]  # Notes about roles that cannot be animated, one sentence each.


def read_target(
    armature: bpy.types.Object, scene: bpy.types.Scene, rig_map: RigMap, limbs: str, fingers: Collection[str] = ()
) -> TargetRig:
    """Read a target rig with its map and FK/IK switches. ``fingers`` are the finger roles in the motion."""
    _check_object(armature)
    notes: list[str] = []
    bones = _with_carrier(armature, _usable_bones(armature, rig_map, notes), notes)
    there = armature.pose.bones
    switches = {(s.bone, s.key): getattr(s, limbs) for s in rig_map.switches if s.key in there[s.bone]}
    posed = [bone for role, bone in bones.items() if not is_of_a_finger(role) or role in fingers]
    hanging = hanging_of(armature, scene, posed, switches)
    if stiff := [bone for role, bone in bones.items() if is_of_a_finger(role) and bone in hanging.held]:
        notes.append(f"Fingers with constraints or drivers get no keys: {', '.join(stiff)}.")
        hanging = hanging_of(armature, scene, [bone for bone in posed if bone not in stiff], switches)
    role_of = {bone: role for role, bone in bones.items()}
    roles = tuple(role_of[name] for name in hanging.names)
    _check_controls(armature, hanging, role_of, notes)
    unit_m = _scale(armature) * scene.unit_settings.scale_length
    target, soles = stand_on_stage(armature, hanging, roles, bones, unit_m)
    modes = {name: there[name].rotation_mode for name in target.names}
    return TargetRig(armature, target, switches, modes, soles, tuple(notes))


def _check_object(armature: bpy.types.Object) -> None:
    if armature is None or armature.type != "ARMATURE":
        hint = "Choose the character's armature."
        raise TargetUnsuitable("The target is not an armature.", where=getattr(armature, "name", ""), hint=hint)
    if armature.library is not None:
        hint = "Make a library override of it first (Object > Library Override > Make)."
        raise TargetUnsuitable("The target is linked and cannot be keyed.", where=armature.name, hint=hint)
    _scale(armature)
    for ring, what in ((_object_ring(armature), "objects"), (_constraint_ring(armature), "bones")):
        if ring:
            hint = "Mute or remove one of their constraints."
            chain = " ← ".join(ring)
            raise TargetUnsuitable(f"The {what} {chain} depend on each other.", where=armature.name, hint=hint)


def _scale(armature: bpy.types.Object) -> float:
    scale = float(even_scale(armature.matrix_world))
    if np.isnan(scale):
        hint = "Scale the armature and its parents equally in all directions. You can move, rotate and mirror it."
        raise TargetUnsuitable("The armature is stretched or flat.", where=armature.name, hint=hint)
    return scale


def _usable_bones(armature: bpy.types.Object, rig_map: RigMap, notes: list[str]) -> dict[str, str]:
    there = armature.pose.bones
    absent = [f"{bone} ({role})" for role, bone in rig_map.bones.items() if bone not in there]
    if absent:
        hint = "Choose the rig's own preset, or correct the table."
        raise MapInvalid(f"The rig has no bones {', '.join(absent)}.", where=armature.name, hint=hint)
    bones = dict(rig_map.bones)
    if doubled := [bone for bone in bones.values() if list(bones.values()).count(bone) > 1]:
        hint = "Assign a different bone to each role."
        raise MapInvalid(f"The bone {doubled[0]} has two roles.", where=armature.name, hint=hint)
    missing = [role for role in JOINT_OF if role not in bones]
    if "pelvis" not in bones or not any(set(roles) <= bones.keys() for roles in LIMBS.values()):
        needed = "Map at least the pelvis and one whole limb: choose a preset or fill the table."
        what = f"The map has no bones for {', '.join(missing)}" if bones else "No human bones were recognised"
        raise MapInvalid(f"{what}.", where=armature.name, hint=" ".join([*rig_map.doubts, needed]))
    if missing:
        notes.append(f"The rig has no bones for {', '.join(missing)}, so these parts are not animated.")
    locked = {role: bone for role, bone in bones.items() if _is_locked(there[bone], role)}
    hinges = {role for roles in LIMBS.values() for role in roles[:2]} | {"pelvis", "carrier"}
    if stuck := [bone for role, bone in locked.items() if role in hinges]:
        hint = "Unlock their rotation (and the carrier's location) in the bones' Transform panel."
        raise TargetUnsuitable(f"Locked channels stop {', '.join(stuck)} from moving.", where=armature.name, hint=hint)
    if locked:
        notes.append(f"Locked and not animated: {', '.join(locked.values())}.")
    return {role: bone for role, bone in bones.items() if role not in locked}


def _with_carrier(armature: bpy.types.Object, bones: dict[str, str], notes: list[str]) -> dict[str, str]:
    """Add a carrier, the nearest movable ancestor, if the pelvis is connected to its parent and cannot move."""
    pelvis = armature.data.bones[bones["pelvis"]]
    if "carrier" in bones or not (pelvis.use_connect and pelvis.parent):
        return bones
    carrier = next((bone for bone in pelvis.parent_recursive if not (bone.use_connect and bone.parent)), None)
    if carrier is None or carrier.name in (bone for role, bone in bones.items() if role != "root"):
        return bones
    notes.append(f"{pelvis.name} is connected to its parent, so {carrier.name} carries the body.")
    return {"carrier": carrier.name} | {role: bone for role, bone in bones.items() if bone != carrier.name}


def _is_locked(bone: bpy.types.PoseBone, role: str) -> bool:
    place_alone = role.endswith("_pole")
    with_place = role in ("carrier", "root") or (role.partition("_")[2] in HELPER_OF and role[-3:] == "_ik")
    turns = any(bone.lock_rotation) or (bone.lock_rotations_4d and bone.lock_rotation_w)
    return (turns and not place_alone) or ((with_place or place_alone) and any(bone.lock_location))


def _check_controls(armature: bpy.types.Object, hanging: Hanging, role_of: dict[str, str], notes: list[str]) -> None:
    """Reject controls that do not respond, and add notes about controls that only partly follow others."""
    by_role = {role_of[name]: name for name in hanging.names}
    carrier = by_role.get("carrier") or by_role["pelvis"]
    if stuck := [name for name in hanging.held if not role_of[name].endswith("_pole")]:
        message = f"Constraints or drivers prevent {', '.join(stuck)} from turning."
        hint = "Mute their constraints, or map the controls that turn them."
        raise TargetUnsuitable(message, where=armature.name, hint=hint)
    if carrier in hanging.unmoved:
        hint = "Disconnect it from its parent, or choose another bone as carrier."
        raise TargetUnsuitable(f"The location channels do not move {carrier}.", where=armature.name, hint=hint)
    body = [name for name in hanging.partial if role_of[name].partition("_")[2] not in HELPER_OF]
    if body:
        notes.append(f"Other controls also move {', '.join(body)}. Check the pose of these bones.")
