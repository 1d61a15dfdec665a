"""The bones of root, hands, feet and poles, added while the armature is edited."""

from __future__ import annotations

import bpy
import numpy as np

from ...conventions.skeleton import JOINTS, PARENTS
from ..layout import BoneLayout
from .limbs import HELPERS, LIMBS, ROOT, Limb

ROOT_LENGTH_M = 0.3
_REACH = 0.15
"""Length of the bone at a limb's end, as a share of the lower bone."""
_POLE_DISTANCE = 1.0
"""How far poles are from their joints, in lengths of the upper bone."""
_POLE_SIZE = 0.1
_AHEAD = {"arm": np.array([0.0, 1.0, 0.0]), "leg": np.array([0.0, -1.0, 0.0])}
"""Where elbows and knees point at rest: backward and forward."""


def add_root(data: bpy.types.Armature) -> bpy.types.EditBone:
    """Add the root: head at the armature's origin, axes those of the armature."""
    root = data.edit_bones.new(ROOT)
    root.head, root.tail = (0.0, 0.0, 0.0), (0.0, ROOT_LENGTH_M, 0.0)
    root.align_roll((0.0, 0.0, 1.0))
    root.use_deform = False
    return root


def add_limb_bones(data: bpy.types.Armature, layout: BoneLayout) -> None:
    """Add the bones of all limbs to an armature that has its joints and root, in edit mode."""
    for limb in LIMBS:
        _add_limb(data, layout, limb)


def rest_pole(layout: BoneLayout, limb: Limb) -> np.ndarray:
    """Return the (3,) place of a limb's pole at rest."""
    upper, lower, _ = (layout.heads[JOINTS.index(joint)] for joint in limb.joints)
    return lower + _POLE_DISTANCE * np.linalg.norm(lower - upper) * _AHEAD[limb.kind]


def _add_limb(data: bpy.types.Armature, layout: BoneLayout, limb: Limb) -> None:
    bones, root = data.edit_bones, data.edit_bones[ROOT]
    upper, lower, end = limb.joints
    above = bones[JOINTS[PARENTS[JOINTS.index(upper)]]]
    for joint, solved, turn in zip((upper, lower), limb.solved, limb.turns, strict=True):
        above = _twin(data, solved, joint, above)
        _twin(data, turn, joint, above)
    knee, ankle = (layout.heads[JOINTS.index(joint)] for joint in (lower, end))
    reach = bones.new(limb.reach)
    reach.head, reach.tail = (ankle + _REACH * (knee - ankle)).tolist(), ankle.tolist()
    reach.roll, reach.parent = bones[lower].roll, above
    _twin(data, limb.control, end, root)
    pole, place = bones.new(limb.pole), rest_pole(layout, limb)
    pole.head, pole.tail = place.tolist(), (place + [0.0, _POLE_SIZE, 0.0]).tolist()
    pole.align_roll((0.0, 0.0, 1.0))
    pole.parent = root
    for name in (*limb.keyed, *HELPERS):
        if name in bones:
            bones[name].use_deform = False


def _twin(data: bpy.types.Armature, name: str, joint: str, parent: bpy.types.EditBone) -> bpy.types.EditBone:
    """Add a bone that lies as a joint's does."""
    bone, like = data.edit_bones.new(name), data.edit_bones[joint]
    bone.head, bone.tail, bone.roll = like.head, like.tail, like.roll
    bone.parent = parent
    return bone
