"""The armature: 24 bones with SMPL's joint names, standing at rest in Blender's axes."""

from __future__ import annotations

import bpy
import numpy as np

from ..files.body_file import BodyFile
from ..files.skeleton import JOINTS, MAIN_CHILD, PARENTS
from .coordinates import R_ARMATURE_BODY

_FORWARD, _UP = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_LEAF_DIRECTION = {10: _FORWARD, 11: _FORWARD, 15: _UP}
"""Where feet and head point, in the armature's frame; hands go on as the forearm does."""
_ROLL_UP = frozenset({7, 8, 10, 11})
"""Bones that point forward: their z axis looks up; that of all others looks forward, so that limbs flex about x."""
_SHORTEST_M = 0.02
_SIDE_PALETTE = {"left": "THEME04", "right": "THEME01"}


def create_armature(name: str, body: BodyFile, betas: np.ndarray, collection: bpy.types.Collection) -> bpy.types.Object:
    """Create the armature object of a shaped body at the world's origin.

    Bones start at the shaped joints and end at the next joint of their chain; bones without one end at the
    surface. Pose bones turn by quaternions. Blender must be in object mode; the object becomes the active one.

    Args:
        name: name of the object.
        body: the body.
        betas: (10,) shape.
        collection: where the object is linked; it must be part of the current view layer.
    """
    data = bpy.data.armatures.new(name)
    armature = bpy.data.objects.new(name, data)
    collection.objects.link(armature)
    heads = body.rest_joints(betas) @ R_ARMATURE_BODY.T
    tails = _tails(heads, body, body.shaped(betas) @ R_ARMATURE_BODY.T)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        _add_bones(data, heads, tails)
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    data.display_type = "OCTAHEDRAL"
    armature.show_in_front = True
    for joint in JOINTS:
        bone = armature.pose.bones[joint]
        bone.rotation_mode = "QUATERNION"
        data.bones[joint].color.palette = _SIDE_PALETTE.get(joint.split("_")[0], "DEFAULT")
    return armature


def rotation_from_body_axes(armature: bpy.types.Object) -> np.ndarray:
    """Return the (24, 3, 3) rotations C from the body's axes to each bone's own axes.

    A rotation about an axis v of the body frame is the pose-bone rotation about C v.
    """
    rest = [np.array(armature.data.bones[joint].matrix_local.to_3x3(), dtype=np.float64) for joint in JOINTS]
    return np.stack([R_bone.T @ R_ARMATURE_BODY for R_bone in rest])


def _add_bones(data: bpy.types.Armature, heads: np.ndarray, tails: np.ndarray) -> None:
    """Called in edit mode."""
    for j, joint in enumerate(JOINTS):
        bone = data.edit_bones.new(joint)
        bone.head, bone.tail = heads[j].tolist(), tails[j].tolist()
        bone.align_roll((_UP if j in _ROLL_UP else _FORWARD).tolist())
        if PARENTS[j] >= 0:
            bone.parent = data.edit_bones[JOINTS[PARENTS[j]]]


def _tails(heads: np.ndarray, body: BodyFile, vertices: np.ndarray) -> np.ndarray:
    tails = np.empty_like(heads)
    owner = body.weights.argmax(axis=1)
    for j in range(len(JOINTS)):
        if j in MAIN_CHILD:
            direction = heads[MAIN_CHILD[j]] - heads[j]
        else:
            unit = _LEAF_DIRECTION.get(j)
            unit = _unit(heads[j] - heads[PARENTS[j]]) if unit is None else unit
            reach = (vertices[owner == j] - heads[j]) @ unit
            direction = unit * max(reach.max(initial=0.0), _SHORTEST_M)
        short = np.linalg.norm(direction) < 1e-3
        tails[j] = heads[j] + (_UP * _SHORTEST_M if short else direction)
    return tails


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v)
    return v / length if length > 1e-6 else _UP
