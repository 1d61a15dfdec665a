"""Rings of constraints: bones that wait for each other, which Blender breaks at a place nobody chose."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

import bpy


def constraint_ring(armature: bpy.types.Object) -> list[str]:
    """Return the bones of a ring in which each waits for the next, through parents and constraints; empty for none."""
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


def object_ring(obj: bpy.types.Object) -> list[str]:
    """Return the objects of a ring of parents and constraints that an object is part of; empty for none."""
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
    """Return names of which each waits for the next; empty where no names do."""
    try:
        TopologicalSorter(waits).prepare()
    except CycleError as ring:
        return list(ring.args[1])
    return []


def _targets(constraint: bpy.types.Constraint, armature: bpy.types.Object) -> set[str]:
    """Return the bones of this armature that a constraint looks at."""
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
