"""A take as other programs can read it: a body without drivers, with a key on every frame."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix

from .._exchange.progress import Progress
from .._exchange.so3 import quat_from_matrix, sign_continuous
from ..animation.curves import CurveTarget, create_action, key_type_values, write_curves
from ..animation.ground_path import GroundPath, ground_path
from ..body.armature import deform_bone
from ..body.controls.limbs import ROOT
from ..conventions.skeleton import layout_of
from ..conventions.timing import scene_frame_rate
from ..errors import NothingToExport
from .plain_body import plain_copy
from .pose_samples import PoseSamples, sample_joints
from .take import ExportTake, uniform_scale


@contextmanager
def plain_take(take: ExportTake, progress: Progress) -> Iterator[ExportTake]:
    """Yield a temporary plain copy of a take of ours, under its own names; any other take as it is.

    The copy stands at the world's origin and plays what the armature shows: constraints, the NLA and the object's own
    movement included. It is as large as the file's unit states, and keeps to the take's layout.

    Raises:
        NothingToExport: the armature is stretched, or a motion of others is asked for at another rate than the scene's.
    """
    if not is_body(take):
        if not take.is_on_frames:
            hint = f"Choose {scene_frame_rate(take.scene):g} frames per second, or bvh, trc or csv."
            raise NothingToExport("Only a body of this add-on can be resampled here.", where=take.name, hint=hint)
        yield take
        return
    pose = sample_joints(take, progress)
    active = bpy.context.view_layer.objects.active
    collection = bpy.data.collections.new("Export")
    take.scene.collection.children.link(collection)
    action, originals = None, (take.armature, *take.meshes)
    names = [obj.name for obj in originals]
    called = [take.layout.node or names[0], *names[1:]]
    in_the_way = [obj for name in called if (obj := bpy.data.objects.get(name)) is not None and obj not in originals]
    renamed = {obj: obj.name for obj in (*originals, *in_the_way)}
    try:
        armature, *skins = copies = plain_copy(
            take.armature, next(iter(take.meshes), None), collection, take.layout.root == "root", take.layout.fingers
        )
        armature.parent = None
        armature.matrix_world.identity()
        plain = replace(take, armature=armature, meshes=tuple(skins), first=take.frame_start, step=1.0, is_plain=True)
        scale = take.metres_a_unit * uniform_scale(take) / plain.metres_a_unit
        if scale != 1.0:
            for copy in copies:
                copy.data.transform(Matrix.Scale(scale, 4))
        action = _bake(plain, pose)
        _swap_names(renamed, copies, called)
        yield plain
    finally:
        _remove(collection, action)
        for obj, name in renamed.items():
            if obj.name != name:
                obj.name = name
        bpy.context.view_layer.objects.active = active


def is_body(take: ExportTake) -> bool:
    """Return whether the take is a body of this add-on, with one skin or none."""
    bones = take.armature.data.bones
    return len(take.meshes) <= 1 and all(name in bones for j in layout_of(bones).joints for name in (j, deform_bone(j)))


def _bake(plain: ExportTake, pose: PoseSamples) -> bpy.types.Action:
    """Write sampled rotations and the path as an action of the copy, the travel where the layout wants it."""
    target = create_action(plain.name, plain.armature)
    turns, heads = pose.rotations, pose.heads[:, 0]
    if plain.layout.root != "body":
        path = ground_path(heads, turns[:, 0], pose.fps)
        heads = heads - path.way
        if plain.layout.root == "root":
            back = path.turns.swapaxes(1, 2)
            heads, turns = (back @ heads[..., None])[..., 0], back[:, None] @ turns
            _key_root(target, plain, path)
    _key_joints(target, plain, pose, turns, heads / plain.metres_a_unit)
    return target.action


def _key_joints(
    target: CurveTarget, plain: ExportTake, pose: PoseSamples, turns: np.ndarray, heads: np.ndarray
) -> None:
    """Key the joints by (F, J, 3, 3) rotations from rest and (F, 3) places of the pelvis, in units of the file."""
    bones, times = plain.armature.data.bones, _times(plain)
    types = key_type_values(None, len(times))
    for j, (joint, parent) in enumerate(zip(pose.names, pose.parents, strict=True)):
        if joint not in bones:
            continue  # a finger that is left out
        rest = np.array(bones[joint].matrix_local, np.float64)
        axes = rest[:3, :3]
        local = turns[:, j] if parent < 0 else turns[:, parent].swapaxes(-1, -2) @ turns[:, j]
        if parent < 0:
            location = (heads - rest[:3, 3]) @ axes
            write_curves(target, f'pose.bones["{joint}"].location', joint, times, location, types)
        quaternions = sign_continuous(quat_from_matrix(axes.T @ local @ axes))
        write_curves(target, f'pose.bones["{joint}"].rotation_quaternion', joint, times, quaternions, types)


def _key_root(target: CurveTarget, plain: ExportTake, path: GroundPath) -> None:
    """Key the root bone, which rests at the origin, by the path over the ground."""
    axes, times = np.array(plain.armature.data.bones[ROOT].matrix_local, np.float64)[:3, :3], _times(plain)
    types = key_type_values(None, len(times))
    plain.armature.pose.bones[ROOT].rotation_mode = "QUATERNION"
    location, turns = path.way @ axes / plain.metres_a_unit, axes.T @ path.turns @ axes
    write_curves(target, f'pose.bones["{ROOT}"].location', ROOT, times, location, types)
    quaternions = sign_continuous(quat_from_matrix(turns))
    write_curves(target, f'pose.bones["{ROOT}"].rotation_quaternion', ROOT, times, quaternions, types)


def _times(plain: ExportTake) -> np.ndarray:
    return np.arange(plain.frame_start, plain.frame_end + 1)


def _swap_names(taken: dict[bpy.types.Object, str], copies: tuple, names: list[str]) -> None:
    """Give the copies names that other objects have."""
    for obj, name in taken.items():
        if obj.library is None:  # what is linked has names of its own
            obj.name = f"{name} (source)"
    for copy, name in zip(copies, names, strict=False):
        copy.name = name


def _remove(collection: bpy.types.Collection, action: bpy.types.Action | None) -> None:
    """Remove the copies, also those of a copying that broke, and their collection."""
    objects = list(collection.objects)
    data = {obj.data for obj in objects}
    for obj in objects:
        bpy.data.objects.remove(obj)
    bpy.data.batch_remove([item for item in data if item.users == 0])
    if action is not None:
        bpy.data.actions.remove(action)
    bpy.data.collections.remove(collection)
