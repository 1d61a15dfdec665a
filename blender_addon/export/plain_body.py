"""A plain copy of a body for other programs: a bone a joint at the shaped joints, a mesh of that shape, no drivers.

Files of other formats know neither drivers nor hidden helper bones. The copy plays the same action; its skin is blended
linearly, without the pose correctives.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..body.armature import bone_axes, deform_bone
from ..body.controls.fingers import NAMES
from ..body.controls.limbs import ROOT
from ..body.controls.wiring import FOLLOW
from ..body.correctives import CORRECTIVES
from ..body.layout import is_finger
from ..body.shape import all_sliders, shaped_vertices
from ..conventions.skeleton import BodyLayout, layout_of


def plain_copy(
    armature: bpy.types.Object,
    mesh: bpy.types.Object | None,
    collection: bpy.types.Collection,
    root: bool = False,
    fingers: bool = True,
) -> tuple[bpy.types.Object, ...]:
    """Copy a body without shape keys, drivers and deform bones; rotations mean the same on both.

    Blender must be in object mode.

    Args:
        armature: of the body.
        mesh: its skin, None for the skeleton alone.
        collection: where the copy is linked; it must be part of the current view layer.
        root: keep the root bone, too.
        fingers: keep the bones of fingers; without, the joints above carry their skin.

    Returns:
        The armature and, where there is a skin, the mesh.

    Raises:
        BodyInvalid: the mesh is no body of ours.
    """
    vertices = None
    if mesh is not None:
        all_sliders(mesh)
        vertices = shaped_vertices(mesh)
    bones = _copy_armature(armature, collection, root, fingers)
    if mesh is None or vertices is None:
        return (bones,)
    return bones, _copy_skin(mesh, vertices, bones, layout_of(armature.data.bones), collection)


def _copy_skin(
    source: bpy.types.Object, vertices: np.ndarray, armature: bpy.types.Object, layout: BodyLayout,
    collection: bpy.types.Collection,
) -> bpy.types.Object:  # fmt: skip
    mesh = local_copy(source, collection)
    keys = mesh.data.shape_keys.name
    mesh.shape_key_clear()
    if keys in bpy.data.shape_keys:  # before Blender 5 they outlive their mesh
        bpy.data.batch_remove((bpy.data.shape_keys[keys],))
    mesh.data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.data.update()
    mesh.parent = armature
    for joint in (name for name in layout.joints if name in armature.data.bones):
        mesh.vertex_groups[deform_bone(joint)].name = joint
    _carry_left_out(mesh, armature, layout)
    correctives = mesh.modifiers.get(CORRECTIVES)
    if correctives is not None:
        mesh.modifiers.remove(correctives)
    mesh.animation_data_clear()
    for modifier in mesh.modifiers:
        if modifier.type == "ARMATURE":
            modifier.object = armature
    return mesh


def _carry_left_out(mesh: bpy.types.Object, armature: bpy.types.Object, layout: BodyLayout) -> None:
    """Give the weights of joints without a bone to the nearest joint above that has one."""
    groups = mesh.vertex_groups
    left_out = {groups[deform_bone(joint)].index: joint for joint in layout.joints if joint not in armature.data.bones}
    if not left_out:
        return
    for vertex in mesh.data.vertices:
        weights = {item.group: item.weight for item in vertex.groups if item.group in left_out}
        for index, weight in weights.items():
            joint = layout.joints.index(left_out[index])
            while layout.joints[joint] not in armature.data.bones:
                joint = layout.parents[joint]
            groups[layout.joints[joint]].add([vertex.index], weight, "ADD")
    for joint in left_out.values():
        groups.remove(groups[deform_bone(joint)])


def local_copy(source: bpy.types.Object, collection: bpy.types.Collection) -> bpy.types.Object:
    """Return a copy of an object and its data in a collection, free to be edited also where they are overrides."""
    copy = source.copy()
    collection.objects.link(copy)
    if copy.override_library is not None:
        copy.make_local(clear_liboverride=True)
    data = source.data.copy()
    if data.override_library is not None:
        data.make_local(clear_liboverride=True)
    copy.data = data
    return copy


def _copy_armature(
    source: bpy.types.Object, collection: bpy.types.Collection, root: bool, fingers: bool
) -> bpy.types.Object:
    moved, layout = _shape_shifts(source), layout_of(source.data.bones)
    joints = [joint for joint in layout.joints if fingers or not is_finger(joint)]
    kept = [*joints, ROOT] if root else joints
    armature = local_copy(source, collection)
    armature.animation_data_clear()
    # Before their bones go: Blender reports constraints without a target on the console.
    for follow in [(bone, c) for bone in armature.pose.bones for c in bone.constraints if c.name in (FOLLOW, *NAMES)]:
        follow[0].constraints.remove(follow[1])
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        bones = armature.data.edit_bones
        for bone in [bone for bone in bones if bone.name not in kept]:
            bones.remove(bone)
        if root:
            bones[ROOT].use_deform = True  # exporters leave out what does not deform
        for j, joint in enumerate(layout.joints):
            if joint not in joints:
                continue
            bones[joint].use_deform = True
            matrix = bones[joint].matrix.copy()
            matrix.translation = (np.array(matrix.translation) + moved[j]).tolist()
            bones[joint].matrix = matrix
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    for joint in joints[1:]:
        armature.pose.bones[joint].location = (0.0, 0.0, 0.0)
    _share_action(source, armature)
    return armature


def _shape_shifts(armature: bpy.types.Object) -> np.ndarray:
    """Return the (J, 3) distances from the rest joints to those of the sliders' shape, in the armature's frame."""
    evaluated = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    layout = layout_of(armature.data.bones)
    shifts = np.zeros((layout.num_joints, 3))
    for j, axes in enumerate(bone_axes(armature)):
        if (parent := layout.parents[j]) >= 0:
            location = np.array(evaluated.pose.bones[layout.joints[j]].location, dtype=np.float64)
            shifts[j] = shifts[parent] + axes @ location
    return shifts


def _share_action(source: bpy.types.Object, target: bpy.types.Object) -> None:
    if source.animation_data is None or source.animation_data.action is None:
        return
    animation = target.animation_data_create()
    animation.action = source.animation_data.action
    if hasattr(animation, "action_slot"):
        animation.action_slot = source.animation_data.action_slot
