"""Add the face: shape keys with ARKit's 52 names, and bones for the jaw, eyes and upper lids.

The effects of bones and keys add up. The skin weights of a bone are derived from a facial shape: a vertex gets the
length of its movement in the shape, relative to its movement with the bone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import bpy
import numpy as np

from .._exchange.errors import BodyInvalid
from .._exchange.so3 import matrix_from_rotvec
from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.naming import MANNEQUIN
from ..conventions.nodes import add_scripted_driver
from ..conventions.skeleton import JOINTS
from .armature import DEFORM_COLLECTION, deform_bone, paint
from .body_file import BodyFile
from .controls.limbs import LIMBS
from .controls.shapes import show_shape
from .mesh import positions
from .shape import LOOK_KEYS, add_key, get_betas, sliders

FACE = "face_shapes"  # Custom property of the shape keys that lists the names of the facial keys.
_HEAD, _COLLECTION, _LEAST_WEIGHT = "head", "Face", 1e-3
_LENGTH_M, _SIZE_M = 0.02, 0.006  # Length of the bones, and half the size of their controls, in metres. Chosen by hand.


class _FaceBone(NamedTuple):
    """One bone of the face. Points are in metres, relative to the head joint of the mean body."""

    shape: str  # Facial shape from which the bone's skin weights are derived.
    turn_deg: tuple[float, float, float]  # Rotation vector of the bone when the shape has value 1, in degrees.
    pivot: tuple[float, float, float]
    control: tuple[float, float, float]  # Position of the bone's control, in front of the skin.


_BONES = {
    "jaw": _FaceBone("jawOpen", (19.0, 0.0, 0.0), (0.0, 0.040, 0.014), (0.0, -0.025, 0.125)),
    "left_eye": _FaceBone("eyeLookOutLeft", (0.0, 25.0, 0.0), (0.0322, 0.074, 0.0863), (0.032, 0.074, 0.13)),
    "right_eye": _FaceBone("eyeLookOutRight", (0.0, -25.0, 0.0), (-0.0322, 0.074, 0.0863), (-0.032, 0.074, 0.13)),
    "left_eyelid": _FaceBone("eyeBlinkLeft", (24.4, 0.0, 0.0), (0.0322, 0.074, 0.0863), (0.032, 0.09, 0.125)),
    "right_eyelid": _FaceBone("eyeBlinkRight", (24.4, 0.0, 0.0), (-0.0322, 0.074, 0.0863), (-0.032, 0.09, 0.125)),
}
"""Rotations and pivots are the same as in ``assets_procedural.detail.expressions``."""
_GAZE_DEG = {"In": (0.0, -25.0, 0.0), "Out": (0.0, 25.0, 0.0), "Up": (-11.0, 0.0, 0.0), "Down": (16.0, 0.0, 0.0)}
"""Rotation vectors of the left eye in the ``eyeLook`` shapes, at value 1, in degrees."""


def face_bones(armature: bpy.types.Object) -> list[str]:
    """Return the names of an armature's face bones."""
    return [name for name in _BONES if name in armature.data.bones and deform_bone(name) in armature.data.bones]


def turns_of_shapes(values: Mapping[str, np.ndarray], frames: int) -> dict[str, np.ndarray]:
    """Convert values of facial shapes to rotation vectors (F, 3) of the jaw and eyes, in the body's axes."""
    none = np.zeros(frames)
    found = {"jaw": np.outer(values.get("jawOpen", none), np.deg2rad(_BONES["jaw"].turn_deg))}
    for side, flip in (("Left", 1.0), ("Right", -1.0)):
        ways = [np.outer(values.get(f"eyeLook{way}{side}", none), turn) for way, turn in _GAZE_DEG.items()]
        found[f"{side.lower()}_eye"] = np.deg2rad(sum(ways)) * [1.0, flip, 1.0]
    return found


def add_face_shapes(mesh: bpy.types.Object, body: BodyFile) -> int:
    """Add the facial shapes as keys with ARKit's names, and return the number of added keys."""
    keys = mesh.data.shape_keys
    rest, new = positions(keys.reference_key.points), [name for name in body.face_shapes if name not in keys.key_blocks]
    if body.face_shapes and len(rest) != len(body.v_template):
        raise BodyInvalid("The mesh is not the skin of its body.", where=mesh.name, hint="Select the mesh of a body.")
    for name in new:
        vertices, offsets = body.face_shapes[name]
        moved = rest.copy()
        moved[vertices] += offsets @ R_ARMATURE_BODY.T
        add_key(mesh, name, moved, 1.0).slider_min = 0.0
    keys[FACE] = list(body.face_shapes)
    return len(new)


def add_face_bones(armature: bpy.types.Object, mesh: bpy.types.Object, body: BodyFile) -> int:
    """Add the face bones that are missing from a body in its current shape, and return their number.

    Blender must be in object mode, with the armature in the view layer. Bones that the user added keep their names.
    """
    new = {name: bone for name, bone in _BONES.items() if name not in armature.data.bones}
    if not new:
        _rest_when_blank(armature, mesh.data.shape_keys)
        return 0
    betas, head = get_betas(mesh), JOINTS.index(_HEAD)
    joints = np.stack([body.rest_joints(np.zeros_like(betas))[head], body.rest_joints(betas)[head]])
    moved = body.shaped(betas) - body.v_template - (joints[1] - joints[0])
    weights = {name: _weights(bone, joints[0] + bone.pivot, body) for name, bone in new.items()}
    places = {name: bone.pivot + np.average(moved, axis=0, weights=weights[name]) for name, bone in new.items()}
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        _add_bones(armature.data, places)
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    _wire(armature, mesh.data.shape_keys, new)
    for name in new:
        _give_skin(mesh, deform_bone(name), weights[name])
    return len(new)


def _weights(bone: _FaceBone, pivot: np.ndarray, body: BodyFile) -> np.ndarray:
    """Return the bone weights (V,) that best reproduce a facial shape by a rotation about a pivot."""
    vertices, offsets = body.face_shapes[bone.shape]
    points = body.v_template[vertices] - pivot
    moved = points @ matrix_from_rotvec(np.deg2rad(bone.turn_deg)).T - points
    if bone.turn_deg[0]:
        offsets = np.where(offsets[:, 1:2] < 0, offsets, 0.0)  # use only downward movement, because the lower lid rises
    found = np.zeros(len(body.v_template))
    found[vertices] = np.sum(offsets * moved, axis=1) / np.maximum(np.sum(moved**2, axis=1), 1e-12)
    return found.clip(0.0, 1.0)


def _add_bones(data: bpy.types.Armature, places: dict[str, np.ndarray]) -> None:
    head = data.edit_bones[_HEAD]
    way = np.array(head.matrix.to_3x3())[:, 1] * _LENGTH_M
    for name, place in places.items():
        above, start = head, np.array(head.head) + R_ARMATURE_BODY @ place
        for each in (name, deform_bone(name)):
            bone = data.edit_bones.new(each)
            bone.head, bone.tail, bone.roll, bone.parent = start.tolist(), (start + way).tolist(), head.roll, above
            bone.use_deform, above = each != name, bone


def _wire(armature: bpy.types.Object, keys: bpy.types.Key, new: dict[str, _FaceBone]) -> None:
    """Set up the face controls. Deform bones copy the head deform bone's location, to cancel the sliders' offset."""
    data, bones = armature.data, armature.pose.bones
    shown = data.collections_all.get(_COLLECTION) or data.collections.new(_COLLECTION)
    axes = np.array(data.bones[_HEAD].matrix_local.to_3x3()).T @ R_ARMATURE_BODY
    shape = bones[LIMBS[0].pole].custom_shape if LIMBS[0].pole in bones else None
    for name, own in new.items():
        bone, deform = bones[name], bones[deform_bone(name)]
        bone.rotation_mode, bone.lock_location, bone.lock_scale = "QUATERNION", (True,) * 3, (True,) * 3
        if shape is not None:
            show_shape(bone, shape, axes @ (np.array(own.control) - own.pivot), np.full(3, _SIZE_M))
        paint(bone)
        shown.assign(data.bones[name])
        if (hidden := data.collections_all.get(DEFORM_COLLECTION)) is not None:
            hidden.assign(data.bones[deform.name])
        back = deform.constraints.new("COPY_LOCATION")
        back.target, back.subtarget = armature, deform_bone(_HEAD)
        back.owner_space = back.target_space = "LOCAL"
    _rest_when_blank(armature, keys)


def _rest_when_blank(armature: bpy.types.Object, keys: bpy.types.Key) -> None:
    """Add missing constraints and drivers that keep the face bones at rest while the face is blank."""
    if (blank := LOOK_KEYS[MANNEQUIN]) not in keys.key_blocks:
        return
    bones = armature.pose.bones
    for bone in (bones[name] for name in _BONES if name in bones and deform_bone(name) in bones):
        if blank not in bone.constraints:
            still = bone.constraints.new("LIMIT_ROTATION")
            still.name, still.owner_space = blank, "LOCAL"
            still.use_limit_x = still.use_limit_y = still.use_limit_z = True
            add_scripted_driver(still, "influence", -1, "blank", {"blank": (keys, f'key_blocks["{blank}"].value')})


def _give_skin(mesh: bpy.types.Object, name: str, weights: np.ndarray) -> None:
    """Give a bone its weights (V,), and scale down the weights of all other bones."""
    group = mesh.vertex_groups.new(name=name)
    for vertex in np.flatnonzero(weights > _LEAST_WEIGHT).tolist():
        for item in mesh.data.vertices[vertex].groups:
            item.weight *= 1.0 - weights[vertex]
        group.add([vertex], weights[vertex], "REPLACE")


def expressions_of(mesh: bpy.types.Object) -> list[bpy.types.ShapeKey]:
    """Return the facial shape keys that are not muted, including keys that the user added."""
    keys, known = mesh.data.shape_keys, {key.name for key in sliders(mesh)} | {*LOOK_KEYS.values()}
    return [key for key in keys.key_blocks if key != keys.reference_key and key.name not in known and not key.mute]
