"""Foreign skeletons as armatures in Blender: tails that importers invent, a skin on feet, odd scales and axes."""

from __future__ import annotations

import bpy
import numpy as np

from tests.support.foreign_skeletons import ForeignSkeleton
from tests.support.retarget_measures import Limb

_SIDES = ("left", "right")
_SHOE = np.array([[x, y, z] for x in (-0.045, 0.045) for y in (-0.17, 0.05) for z in (-0.055, 0.03)])
"""Corners of a shoe about an ankle; its sole is 85 mm below the ankle with a heel of 30 mm."""


def foreign_rig(
    skeleton: ForeignSkeleton, *, unit: float = 1.0, tails: float = 1.0, y_up: bool = False, sole: float | None = None
) -> tuple[bpy.types.Object, dict[str, Limb]]:
    """Build an armature in the current scene.

    Args:
        skeleton: its bones.
        unit: scale of the object; bones are so much smaller inside.
        tails: length of bones by the way to the first child: importers of glTF make up any.
        y_up: whether the armature counts upwards along Y inside, and its object turns it.
        sole: height of the lowest vertices of a skin on the feet; None for no mesh.

    Returns:
        The object, and the limbs for ``score``.
    """
    data = bpy.data.armatures.new("Foreign")
    rig = bpy.data.objects.new("Foreign", data)
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float) if y_up else np.eye(3)
    heads = {bone: turn @ head / unit for bone, head in skeleton.heads.items()}
    for bone, head in heads.items():
        new = data.edit_bones.new(bone)
        below = [heads[child] for child, parent in skeleton.parents.items() if parent == bone]
        way = (below[0] - head) if below else np.zeros(3)
        way = way if np.linalg.norm(way) > 1e-4 / unit else turn @ [0, 0.02, 0.03] / unit
        new.head, new.tail = head.tolist(), (head + tails * way).tolist()
        if bone in skeleton.parents:
            new.parent = data.edit_bones[skeleton.parents[bone]]
    bpy.ops.object.mode_set(mode="OBJECT")
    rig.scale = (unit, unit, unit)
    rig.rotation_euler = (np.pi / 2 if y_up else 0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    if sole is not None:
        _add_shoes(rig, skeleton, sole)
    return rig, limbs_of(skeleton.roles)


def limbs_of(bones: dict[str, str]) -> dict[str, Limb]:
    """Return the limbs for ``score`` from bones by role."""
    parts = {"arm": ("upper_arm", "forearm", "hand"), "leg": ("thigh", "shin", "foot", "toe")}
    return {
        f"{side}_{limb}": Limb(tuple(bones[f"{side}_{part}"] for part in names))
        for side in _SIDES
        for limb, names in parts.items()
    }


def _add_shoes(rig: bpy.types.Object, skeleton: ForeignSkeleton, sole: float) -> None:
    points, groups = [], []
    for side in _SIDES:
        foot = skeleton.roles[f"{side}_foot"]
        corners = skeleton.heads[foot] + _SHOE
        corners[corners[:, 2] < skeleton.heads[foot][2], 2] = sole
        points += corners.tolist()
        groups += [foot] * len(corners)
    mesh = bpy.data.meshes.new("Shoes")
    mesh.from_pydata(points, [], [])
    shoes = bpy.data.objects.new("Shoes", mesh)
    bpy.context.scene.collection.objects.link(shoes)
    for v, name in enumerate(groups):
        group = shoes.vertex_groups.get(name) or shoes.vertex_groups.new(name=name)
        group.add([v], 1.0, "REPLACE")
    shoes.modifiers.new("Armature", "ARMATURE").object = rig
    bpy.context.view_layer.update()
