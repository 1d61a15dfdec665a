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
from ..animation.action import pose_columns
from ..animation.curves import create_action, key_type_values, write_curves
from ..body.armature import bone_axes, deform_bone
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
    movement included.

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
    try:
        armature, *skins = copies = plain_copy(take.armature, next(iter(take.meshes), None), collection)
        armature.parent = None
        armature.matrix_world.identity()
        scale = take.metres_a_unit * uniform_scale(take)
        if scale != 1.0:
            for copy in copies:
                copy.data.transform(Matrix.Scale(scale, 4))
        action = _bake(armature, pose, take)
        _swap_names(originals, copies, names)
        yield replace(take, armature=armature, meshes=tuple(skins), first=take.frame_start, step=1.0, is_plain=True)
    finally:
        _remove(collection, action)
        for obj, name in zip(originals, names, strict=True):
            if obj.name != name:
                obj.name = name
        bpy.context.view_layer.objects.active = active


def is_body(take: ExportTake) -> bool:
    """Return whether the take is a body of this add-on, with one skin or none."""
    bones = take.armature.data.bones
    return len(take.meshes) <= 1 and all(name in bones for j in layout_of(bones).joints for name in (j, deform_bone(j)))


def _bake(armature: bpy.types.Object, pose: PoseSamples, take: ExportTake) -> bpy.types.Action:
    """Write sampled rotations and the pelvis's path as an action of the copy."""
    axes, layout = bone_axes(armature), layout_of(armature.data.bones)
    parents = list(layout.parents[1:])
    local = pose.rotations.copy()
    local[:, 1:] = pose.rotations[:, parents].swapaxes(-1, -2) @ pose.rotations[:, 1:]
    quaternions = sign_continuous(quat_from_matrix(axes.swapaxes(1, 2) @ local @ axes))
    rest = np.array(armature.data.bones[layout.joints[0]].head_local, dtype=np.float64)
    channels = np.concatenate([(pose.heads[:, 0] - rest) @ axes[0], quaternions.reshape(pose.num_frames, -1)], axis=1)
    target = create_action(take.name, armature)
    times = np.arange(take.frame_start, take.frame_end + 1)
    types = key_type_values(None, pose.num_frames)
    for path, joint, part in pose_columns(layout):
        write_curves(target, path, joint, times, channels[:, part], types)
    return target.action


def _swap_names(originals: tuple, copies: tuple, names: list[str]) -> None:
    """Give the copies the names that the originals have."""
    for original, copy, name in zip(originals, copies, names, strict=True):
        if original.library is None:  # what is linked has names of its own
            original.name = f"{name} (source)"
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
