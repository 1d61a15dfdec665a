"""Convert a take for other programs: remove drivers and key every frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from .._exchange.ground_path import ground_path
from .._exchange.progress import Progress
from .._exchange.so3 import quat_from_matrix, sign_continuous
from ..animation.action import key_root
from ..animation.curves import CurveTarget, create_action, key_type_values, write_curves
from ..body.armature import deform_bone, shape_shifts
from ..body.controls.limbs import NAMES, ROOT
from ..body.controls.wiring import FOLLOW
from ..body.correctives import CORRECTIVES
from ..body.face import expressions_of, face_bones
from ..body.layout import is_finger
from ..body.looks import keep_shown
from ..body.mesh import positions
from ..body.shape import LARGEST_BETA, add_key, all_sliders, shaped_vertices
from ..conventions.skeleton import BodyLayout, layout_of
from ..conventions.timing import go_to_frame, scene_frame_rate
from ..errors import NothingToExport
from ..scene.session import alone
from .take import ExportTake, PoseSamples, against_parents, sample_pose, uniform_scale


def plain_copy(
    armature: bpy.types.Object,
    mesh: bpy.types.Object | None,
    collection: bpy.types.Collection,
    root: bool = False,
    fingers: bool = True,
) -> tuple[bpy.types.Object, ...]:
    """Copy a body and, if given, its skin, without sliders, drivers and deform bones.

    The copy keeps the shape keys of the face and of the user. ``root`` keeps the root bone, and ``fingers`` keeps the
    finger bones. The skin of omitted bones is assigned to their parent joints. A mesh must be a body of this add-on.
    Blender must be in object mode, and the collection must be in the view layer.
    """
    vertices = None
    if mesh is not None:
        all_sliders(mesh)
        vertices = shaped_vertices(mesh)
    bones = _copy_armature(armature, collection, root, fingers)
    if mesh is None or vertices is None:
        return (bones,)
    return bones, _copy_skin(local_copy(mesh, collection), vertices, bones, layout_of(armature.data.bones))


def _copy_skin(
    mesh: bpy.types.Object, vertices: np.ndarray, armature: bpy.types.Object, layout: BodyLayout
) -> bpy.types.Object:
    """Bind a copied skin to a plain armature. Sliders and correctives are removed."""
    keys = mesh.data.shape_keys.name
    expressions = {key.name: (_offsets(mesh, key), key.value) for key in expressions_of(mesh)}
    mesh.shape_key_clear()
    if keys in bpy.data.shape_keys:  # before Blender 5, shape keys outlive their mesh
        bpy.data.batch_remove((bpy.data.shape_keys[keys],))
    mesh.data.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    if expressions:
        mesh.shape_key_add(name="Basis", from_mix=False)
    for name, (offsets, value) in expressions.items():
        add_key(mesh, name, vertices + offsets, LARGEST_BETA).value = value
    keep_shown(mesh)
    mesh.data.update()
    mesh.parent = armature
    for joint in (bone.name for bone in armature.data.bones if deform_bone(bone.name) in mesh.vertex_groups):
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


def _offsets(mesh: bpy.types.Object, key: bpy.types.ShapeKey) -> np.ndarray:
    """Return the offsets (V, 3) in metres of a shape key at value 1, masked by the key's vertex group."""
    moved = positions(key.points) - positions(key.relative_key.points)
    if (group := mesh.vertex_groups.get(key.vertex_group)) is not None:
        for vertex in mesh.data.vertices:
            moved[vertex.index] *= sum(item.weight for item in vertex.groups if item.group == group.index)
    return moved


def _carry_left_out(mesh: bpy.types.Object, armature: bpy.types.Object, layout: BodyLayout) -> None:
    """Move the skin weights of each joint that has no bone to the nearest ancestor joint that has one."""
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
    """Copy an object and its data into a collection. Make the copies editable, even if they are library overrides."""
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
    moved, layout = shape_shifts(source), layout_of(source.data.bones)
    joints = [joint for joint in layout.joints if fingers or not is_finger(joint)]
    places = {joint: moved[layout.joints.index(joint)] for joint in joints}
    places |= dict.fromkeys(face_bones(source), places["head"])
    kept = [*places, ROOT] if root else places
    armature = local_copy(source, collection)
    armature.animation_data_clear()
    # Remove constraints before the bones that they refer to, to avoid console messages.
    for follow in [(bone, c) for bone in armature.pose.bones for c in bone.constraints if c.name in (FOLLOW, *NAMES)]:
        follow[0].constraints.remove(follow[1])
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        bones = armature.data.edit_bones
        for bone in [bone for bone in bones if bone.name not in kept]:
            bones.remove(bone)
        if root:
            bones[ROOT].use_deform = True  # exporters leave out bones that do not deform
        for joint, place in places.items():
            bones[joint].use_deform = True
            matrix = bones[joint].matrix.copy()
            matrix.translation = (np.array(matrix.translation) + place).tolist()
            bones[joint].matrix = matrix
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    for joint in joints[1:]:
        armature.pose.bones[joint].location = (0.0, 0.0, 0.0)
    _share_action(source, armature)
    return armature


def _share_action(source: bpy.types.Object, target: bpy.types.Object) -> None:
    if source.animation_data is None or source.animation_data.action is None:
        return
    animation = target.animation_data_create()
    animation.action = source.animation_data.action
    if hasattr(animation, "action_slot"):
        animation.action_slot = source.animation_data.action_slot


@contextmanager
def plain_take(take: ExportTake, progress: Progress) -> Iterator[ExportTake]:
    """Yield a temporary plain copy if the take shows a body of this add-on, or else the take unchanged.

    The copy is at the world origin and plays the evaluated motion of the armature, including constraints, the NLA and
    the object's motion. It has the size and layout that the file requires. Raises ``NothingToExport`` if the armature's
    scale is not uniform, or if the motion of another rig is requested at a rate other than the scene's.
    """
    if not is_body(take):
        if not take.is_on_frames:
            hint = f"Choose {scene_frame_rate(take.scene):g} frames per second, or bvh, trc or csv."
            raise NothingToExport("Only a body from this add-on can be resampled here.", where=take.name, hint=hint)
        yield take
        return
    layout = take.layout
    pose = sample_pose(take, progress, (*layout_of(take.armature.data.bones).joints, *face_bones(take.armature)))
    shapes = [sample_expressions(take, mesh) for mesh in take.meshes]
    active, originals = bpy.context.view_layer.objects.active, (take.armature, *take.meshes)
    actions: list[bpy.types.Action] = []
    names = [layout.node or take.armature.name, *(mesh.name for mesh in take.meshes)]
    in_the_way = [obj for obj in map(bpy.data.objects.get, names) if obj is not None and obj not in originals]
    replaced, skin = [*originals, *in_the_way], next(iter(take.meshes), None)
    try:
        with temporary_copies(take.scene, replaced) as collection:
            copies = plain_copy(take.armature, skin, collection, layout.root == "root", layout.fingers)
            armature, *skins = copies
            armature.parent = None
            armature.matrix_world.identity()
            copied = {"armature": armature, "meshes": tuple(skins)}
            plain = replace(take, **copied, first=take.frame_start, step=1.0, is_plain=True)
            scale = take.metres_a_unit * uniform_scale(take) / plain.metres_a_unit
            for copy in copies if scale != 1.0 else ():
                copy.data.transform(Matrix.Scale(scale, 4))
            actions.append(_bake(plain, pose))
            for mesh, values in zip(skins, shapes, strict=True):
                if values:
                    actions.append(_key_expressions(mesh, values, _times(plain)))
            swap_names(replaced, copies, names)
            with alone(armature, take.scene) as (stage, _):  # exporters evaluate the whole scene in every frame
                for mesh in skins:
                    stage.collection.objects.link(mesh)
                yield replace(plain, scene=stage)
    finally:
        bpy.data.batch_remove(actions)
        bpy.context.view_layer.objects.active = active


@contextmanager
def temporary_copies(scene: bpy.types.Scene, replaced: Sequence[bpy.types.Object]) -> Iterator[bpy.types.Collection]:
    """Yield a collection for temporary copies of objects. Restore the objects' names afterwards."""
    names = {obj: obj.name for obj in replaced}
    collection = bpy.data.collections.new("Export")
    scene.collection.children.link(collection)
    try:
        yield collection
    finally:
        objects = list(collection.objects)
        data = {obj.data for obj in objects}
        for obj in objects:
            bpy.data.objects.remove(obj)
        bpy.data.batch_remove([item for item in data if item.users == 0])
        bpy.data.collections.remove(collection)
        for obj, name in names.items():
            with suppress(ReferenceError):
                if obj.name != name:
                    obj.name = name


def swap_names(replaced: Sequence[bpy.types.Object], copies: Sequence[bpy.types.Object], names: Sequence[str]) -> None:
    """Rename the replaced objects, and give ``names`` to their copies."""
    for obj in replaced:
        if obj.library is None:  # a linked object's name cannot clash
            obj.name = f"{obj.name} (source)"
    for copy, name in zip(copies, names, strict=False):
        copy.name = name


def is_body(take: ExportTake) -> bool:
    """Return whether the take shows a body of this add-on that has at most one skin."""
    bones = take.armature.data.bones
    return len(take.meshes) <= 1 and all(name in bones for j in layout_of(bones).joints for name in (j, deform_bone(j)))


def _bake(plain: ExportTake, pose: PoseSamples) -> bpy.types.Action:
    target = create_action(plain.name, plain.armature)
    turns, heads = pose.rotations, pose.heads[:, 0]
    if plain.layout.root != "body":
        path = ground_path(heads, turns[:, 0], pose.fps)
        heads = heads - path.way
        if plain.layout.root == "root":
            back = path.turns.swapaxes(1, 2)
            heads, turns = (back @ heads[..., None])[..., 0], back[:, None] @ turns
            key_root(target, plain.armature, path, _times(plain), plain.metres_a_unit)
    _key_joints(target, plain, pose, turns, heads / plain.metres_a_unit)
    return target.action


def _key_joints(
    target: CurveTarget, plain: ExportTake, pose: PoseSamples, turns: np.ndarray, heads: np.ndarray
) -> None:
    """Key the joints from world rotations (F, J, 3, 3) and pelvis positions (F, 3), in the units of the file."""
    bones, times = plain.armature.data.bones, _times(plain)
    types, local = key_type_values(None, len(times)), against_parents(turns, pose.parents)
    for j, joint in enumerate(pose.names):
        if joint not in bones:
            continue  # this finger is left out
        rest = np.array(bones[joint].matrix_local, np.float64)
        axes = rest[:3, :3]
        if pose.parents[j] < 0:
            location = (heads - rest[:3, 3]) @ axes
            write_curves(target, f'pose.bones["{joint}"].location', joint, times, location, types)
        quaternions = sign_continuous(quat_from_matrix(axes.T @ local[:, j] @ axes))
        write_curves(target, f'pose.bones["{joint}"].rotation_quaternion', joint, times, quaternions, types)


def sample_expressions(take: ExportTake, mesh: bpy.types.Object) -> dict[str, np.ndarray]:
    """Return the values (F,) of each expression, or {} if no expression is animated."""
    names = [key.name for key in expressions_of(mesh)]
    if not names or mesh.data.shape_keys.animation_data is None:
        return {}
    probe, values = bpy.data.objects.new(mesh.name, mesh.data), np.empty((take.num_frames, len(names)))
    try:
        with alone(probe, take.scene) as (stage, depsgraph):
            for f, time in enumerate(take.times):
                go_to_frame(stage, float(time))
                blocks = probe.evaluated_get(depsgraph).data.shape_keys.key_blocks
                values[f] = [blocks[name].value for name in names]
    finally:
        bpy.data.objects.remove(probe)
    return dict(zip(names, values.T, strict=True))


def _key_expressions(mesh: bpy.types.Object, values: dict[str, np.ndarray], times: np.ndarray) -> bpy.types.Action:
    target, types = create_action(mesh.name, mesh.data.shape_keys), key_type_values(None, len(times))
    for name, column in values.items():
        write_curves(
            target, f'key_blocks["{bpy.utils.escape_identifier(name)}"].value', name, times, column[:, None], types
        )
    return target.action


def _times(plain: ExportTake) -> np.ndarray:
    return np.arange(plain.frame_start, plain.frame_end + 1)
