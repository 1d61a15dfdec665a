"""Build the armature: posed bones, hidden deform bones, and controls.

A pose bone's rest position cannot follow a slider, but its location can. Drivers move the posed bones to the shaped
joints (``rig.py``). The skin must then rotate about the shaped joint without moving, so each posed bone has a deform
bone that is driven back by the same distance. The deform bone then moves the skin by ``G_j (v - J_j(betas)) + p_j``.
"""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.joint_sets import SIDES
from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.skeleton import JOINTS, SMPL_HANDS, BodyLayout, layout_of
from .controls.limbs import COLLECTION as FINGER_COLLECTION
from .controls.limbs import FINGER_CONTROLS as FINGER_CONTROLS
from .controls.limbs import HELPERS, LIMBS, ROOT
from .controls.wiring import add_finger_controls, add_limb_bones, add_root, wire_finger_controls, wire_limbs
from .layout import BoneLayout

DEFORM_COLLECTION, HELPER_COLLECTION = "Deform", "Helpers"


_COLLECTIONS = {
    "Root": (ROOT, "pelvis"),
    "Torso": ("spine1", "spine2", "spine3"),
    "Head": ("neck", "head"),
    "Arm Left": ("left_collar", "left_hand"),
    "Arm Right": ("right_collar", "right_hand"),
    "Leg Left": ("left_foot",),
    "Leg Right": ("right_foot",),
    **{limb.joint_collection: limb.joints for limb in LIMBS},
    **{f"Fingers {s.title()}": tuple(SMPL_HANDS.joints[j] for j in SMPL_HANDS.group(f"{s}_hand")) for s in SIDES},
    **{limb.collection: (limb.control, limb.pole) for limb in LIMBS},
    "IK Twist": tuple(name for limb in LIMBS for name in limb.turns),
    HELPER_COLLECTION: HELPERS,
    FINGER_COLLECTION: FINGER_CONTROLS,
}
_HIDDEN = (DEFORM_COLLECTION, HELPER_COLLECTION, "IK Twist", *(limb.collection for limb in LIMBS))
"""Bone collections that are hidden in a new armature."""
_COLOURS = {"left": (0.22, 0.55, 1.0), "right": (1.0, 0.30, 0.24)}
_MIDDLE_COLOUR = (1.0, 0.76, 0.18)
_SELECTED, _ACTIVE = 0.5, 0.8
"""Fraction of white mixed into the colour of selected bones, and of the active bone."""


def deform_bone(joint: str) -> str:
    """Return the name of the bone that deforms the skin around a joint."""
    return f"{joint}_deform"


def create_armature(
    name: str, joints: BodyLayout, layout: BoneLayout, collection: bpy.types.Collection
) -> bpy.types.Object:
    """Create the armature object at the world origin and make it active."""
    has_fingers = joints.num_joints > len(JOINTS)
    data = bpy.data.armatures.new(name)
    armature = bpy.data.objects.new(name, data)
    collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        _add_bones(data, joints, layout)
        if has_fingers:
            add_finger_controls(data)
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    data.display_type = "OCTAHEDRAL"
    armature.show_in_front = True
    _group_bones(data)
    for joint in (ROOT, *joints.joints):
        bone = armature.pose.bones[joint]
        bone.rotation_mode = "QUATERNION"
        bone.lock_location = (joint not in (ROOT, JOINTS[0]),) * 3
        bone.lock_scale = (True, True, True)
    wire_limbs(armature, layout)
    if has_fingers:
        wire_finger_controls(armature)
    limbs = [name for limb in LIMBS for name in limb.keyed]
    for name in (ROOT, *joints.joints, *limbs, *(FINGER_CONTROLS if has_fingers else ())):
        paint(armature.pose.bones[name])
    return armature


def rotation_from_body_axes(armature: bpy.types.Object) -> np.ndarray:
    """Return rotation matrices (J, 3, 3) from the body's axes to the bones' axes."""
    return np.swapaxes(bone_axes(armature), 1, 2) @ R_ARMATURE_BODY


def bone_axes(armature: bpy.types.Object) -> np.ndarray:
    """Return the rest axes (J, 3, 3) of the posed bones, one per column, in the armature's frame."""
    bones = armature.data.bones
    return np.stack([np.array(bones[joint].matrix_local.to_3x3(), np.float64) for joint in layout_of(bones).joints])


def shape_shifts(armature: bpy.types.Object) -> np.ndarray:
    """Return how far (J, 3) each joint moves from rest to the sliders' shape, in the armature's frame."""
    evaluated = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    layout = layout_of(armature.data.bones)
    shifts = np.zeros((layout.num_joints, 3))
    for j, axes in enumerate(bone_axes(armature)):
        if (parent := layout.parents[j]) >= 0:
            location = np.array(evaluated.pose.bones[layout.joints[j]].location, dtype=np.float64)
            shifts[j] = shifts[parent] + axes @ location
    return shifts


def _add_bones(data: bpy.types.Armature, joints: BodyLayout, layout: BoneLayout) -> None:
    """Add the root, the posed bones and the deform bones. Blender must be in edit mode."""
    root = add_root(data)
    for j, joint in enumerate(joints.joints):
        above = joints.parents[j]
        control = _add_bone(data, joint, layout, j)
        control.use_deform = False
        control.parent = data.edit_bones[joints.joints[above]] if above >= 0 else root
        _add_bone(data, deform_bone(joint), layout, j).parent = control
    add_limb_bones(data, layout)


def _add_bone(data: bpy.types.Armature, name: str, layout: BoneLayout, joint: int) -> bpy.types.EditBone:
    bone = data.edit_bones.new(name)
    bone.head, bone.tail = layout.heads[joint].tolist(), layout.tails[joint].tolist()
    bone.align_roll(layout.roll_axes[joint].tolist())
    return bone


def _group_bones(data: bpy.types.Armature) -> None:
    groups = {**_COLLECTIONS, DEFORM_COLLECTION: tuple(deform_bone(joint) for joint in layout_of(data.bones).joints)}
    for name, bones in groups.items():
        bones = [bone for bone in bones if bone in data.bones]
        if not bones:
            continue
        collection = data.collections.new(name)
        collection.is_visible = name not in _HIDDEN
        for bone in bones:
            collection.assign(data.bones[bone])


def paint(bone: bpy.types.PoseBone) -> None:
    """Colour a bone by its side: left blue, right red, middle yellow."""
    colour, target = np.array(_COLOURS.get(bone.name.split("_")[0], _MIDDLE_COLOUR)), bone.bone.color
    target.palette, target.custom.normal = "CUSTOM", colour
    target.custom.select, target.custom.active = (colour + share * (1 - colour) for share in (_SELECTED, _ACTIVE))
