"""Create custom shapes for bones: wire rings, arches and outlines around the skin."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Matrix

from ...conventions.datablocks import child_collection
from ...conventions.skeleton import JOINTS, BodyLayout
from ..armature import bone_axes
from ..body_file import BodyFile
from ..layout import BoneLayout, body_part, is_finger, standing
from ..mesh import positions
from .limbs import FINGER_CONTROLS as CONTROLS
from .limbs import LIMBS, ROOT, Limb, has_finger_controls

_SEGMENTS = 40
_MARGIN, _LEAST_M = 1.12, 0.012
"""Scale of a custom shape relative to the skin, and its smallest distance in metres from it. Chosen by hand."""
_LEAST_FINGER_M = 0.002  # Smallest distance in metres for fingers, because their rings are close together.
_WIRE_WIDTH = 1.0
_SHAPE_OF_PART = {"pelvis": "plate", "head": "helmet", "hand": "outline", "foot": "outline"}
"""Custom shape of each body part. All other parts have rings."""
_SECTION_OF_PART = {"pelvis": (-1.0, 0.6), "collar": (0.25, 0.9), "neck": (0.1, 0.9), "wrist": (0.0, 1.0)}
"""Section of the bone, as fractions of its length, where the skin is measured. By default it is the middle 30 %."""
_ROOT_SIZE, _POLE_SIZE_M, _TURN_SCALE = 0.18, 0.025, 1.25
"""Root size as a fraction of arm span, pole size in metres, and size of twist rings relative to joint rings."""
_ABOVE_M = 0.022  # Height of the finger controls above the back of the hand, in metres.
_MIDDLE = (0.35, 0.65)
_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar")
"""Bones with rings around the skin of the entire trunk."""


def add_control_shapes(
    armature: bpy.types.Object, body: BodyFile, betas: np.ndarray, layout: BoneLayout
) -> bpy.types.Collection:
    """Give each posed bone a custom shape, and return the hidden collection that contains the shapes."""
    folder = child_collection("Controls", armature.users_collection[0])
    folder.hide_viewport = folder.hide_render = True
    shapes = {name: _wire(f"{armature.name} {name}", curves, folder) for name, curves in _SHAPES.items()}
    vertices, _ = standing(body, betas)
    owner = body.weights.argmax(axis=1)
    trunk = np.isin(owner, [JOINTS.index(joint) for joint in _TRUNK])
    lengths = np.linalg.norm(layout.tails - layout.heads, axis=1)
    for j, axes in enumerate(bone_axes(armature)):
        joint = body.layout.joints[j]
        part = body_part(joint)
        shape = _SHAPE_OF_PART.get(part, "ring")
        measured = trunk if part.startswith("spine") else owner == j
        section = _SECTION_OF_PART.get(part, _MIDDLE if shape == "ring" else (-1.0, 2.0))
        local, least = (vertices[measured] - layout.heads[j]) @ axes, _LEAST_FINGER_M if is_finger(joint) else _LEAST_M
        show_shape(armature.pose.bones[joint], shapes[shape], *_extent(local, lengths[j], section, least))
    show_shape(armature.pose.bones[ROOT], shapes["root"], np.zeros(3), np.full(3, _ROOT_SIZE * np.ptp(vertices[:, 0])))
    for name in CONTROLS if has_finger_controls(armature) else ():
        at, size = (1.9, 0.006) if name.endswith("_curl") else (0.45, 0.012)
        place = np.array([0.0, at * armature.data.bones[name].length, -_ABOVE_M])
        show_shape(armature.pose.bones[name], shapes["diamond"], place, np.full(3, size))
    for limb in LIMBS:
        _add_limb_shapes(armature, limb, body.layout, vertices, owner, shapes)
    return folder


def _add_limb_shapes(
    armature: bpy.types.Object,
    limb: Limb,
    layout: BodyLayout,
    vertices: np.ndarray,
    owner: np.ndarray,
    shapes: dict[str, bpy.types.Object],
) -> None:
    bones, end = armature.pose.bones, layout.joints.index(limb.joints[2])
    rest = np.array(armature.data.bones[limb.control].matrix_local, np.float64)
    below = {end}
    for j, parent in enumerate(layout.parents):
        below |= {j} if parent in below else set()
    inside = np.isin(owner, list(below))
    local = (vertices[inside] - rest[:3, 3]) @ rest[:3, :3]
    size = armature.data.bones[limb.control].length
    show_shape(bones[limb.control], shapes["box"], *_extent(local, size, (-np.inf, np.inf)))
    show_shape(bones[limb.pole], shapes["diamond"], np.zeros(3), np.full(3, _POLE_SIZE_M))
    for turn, joint in zip(limb.turns, limb.joints[:2], strict=True):
        like = bones[joint]
        scale = _TURN_SCALE * np.array(like.custom_shape_scale_xyz)
        show_shape(bones[turn], shapes["ring"], np.array(like.custom_shape_translation), scale)


def show_shape(bone: bpy.types.PoseBone, shape: bpy.types.Object, centre: np.ndarray, half: np.ndarray) -> None:
    """Give a bone a custom shape with this (3,) centre and half size, in metres and in the bone's axes."""
    bone.custom_shape = shape
    bone.use_custom_shape_bone_size = False
    bone.custom_shape_translation, bone.custom_shape_scale_xyz = centre.tolist(), half.tolist()
    if hasattr(bone, "custom_shape_wire_width"):
        bone.custom_shape_wire_width = _WIRE_WIDTH


def shape_lines(armature: bpy.types.Object) -> dict[tuple[float, ...], np.ndarray]:
    """Return the end points (2 E, 3) of the E lines in all visible custom shapes, by bone colour."""
    lines: dict[str, np.ndarray] = {}
    found: dict[tuple[float, ...], list[np.ndarray]] = {}
    for bone in armature.pose.bones:
        shape, colour, rest = bone.custom_shape, bone.color, bone.bone
        colour = rest.color if colour.palette == "DEFAULT" else colour
        is_hidden = getattr(bone, "hide", getattr(rest, "hide", False))  # since Blender 5, pose bones have their own
        if shape is None or is_hidden or colour.palette != "CUSTOM":
            continue
        if rest.collections and not any(item.is_visible_effectively for item in rest.collections):
            continue
        if shape.name not in lines:
            ends = np.empty(2 * len(shape.data.edges), np.int32)
            shape.data.edges.foreach_get("vertices", ends)
            lines[shape.name] = positions(shape.data.vertices)[ends]
        size = bone.custom_shape_scale_xyz * (bone.length if bone.use_custom_shape_bone_size else 1.0)
        carrier = bone.custom_shape_transform or bone
        own = Matrix.LocRotScale(bone.custom_shape_translation, bone.custom_shape_rotation_euler, size)
        world = np.array(armature.matrix_world @ carrier.matrix @ own, np.float32)
        found.setdefault(tuple(colour.custom.normal), []).append(lines[shape.name] @ world[:3, :3].T + world[:3, 3])
    return {colour: np.concatenate(parts) for colour, parts in found.items()}


def _extent(
    local: np.ndarray, length: float, section: tuple[float, float], least: float = _LEAST_M
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre (3,) and half size (3,) of the skin along a section of a bone, including a margin."""
    along = local[:, 1] / length
    inside = local[(along >= section[0]) & (along <= section[1])]
    points = inside if len(inside) > 2 else local
    if not len(points):
        return np.array([0.0, 0.5 * length, 0.0]), np.full(3, 0.25 * length)
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, _MARGIN * (high - low) / 2 + least


def _rounded(power: float, plane: tuple[int, int], share: float = 1.0) -> np.ndarray:
    angle = np.linspace(0.0, 2 * np.pi * share, _SEGMENTS + 1)
    points = np.zeros((len(angle), 3))
    for axis, value in zip(plane, (np.cos(angle), np.sin(angle)), strict=True):
        points[:, axis] = np.sign(value) * np.abs(value) ** (2 / power)
    return points


def _polyline(*points: tuple[float, float], plane: tuple[int, int] = (0, 1), at: float = 0.0) -> np.ndarray:
    line = np.full((len(points), 3), float(at))
    line[:, list(plane)] = points
    return line


_SHAPES: dict[str, tuple[np.ndarray, ...]] = {
    "ring": (_rounded(2, (0, 2)),),
    "plate": (_rounded(4, (0, 2)), 1.12 * _rounded(4, (0, 2))),
    "helmet": (_rounded(2, (0, 2)), _rounded(2, (0, 1), 0.5), _rounded(2, (2, 1), 0.5)),
    "outline": (_rounded(4, (0, 1)),),
    "root": (_rounded(2, (0, 1)), _polyline((-0.2, -1.0), (0.0, -1.3), (0.2, -1.0), (-0.2, -1.0))),
    "diamond": tuple(_polyline((1, 0), (0, 1), (-1, 0), (0, -1), (1, 0), plane=p) for p in ((0, 1), (1, 2), (0, 2))),
    "box": (
        *(_polyline((1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1), at=at) for at in (-1.0, 1.0)),
        *(np.array([(x, y, -1.0), (x, y, 1.0)]) for x in (-1.0, 1.0) for y in (-1.0, 1.0)),
    ),
}
"""Curves of each custom shape, inside the cube from -1 to 1. y runs along the bone."""


def _wire(name: str, curves: Sequence[np.ndarray], collection: bpy.types.Collection) -> bpy.types.Object:
    vertices, edges = [], []
    for points in curves:
        first = len(vertices)
        vertices += points.tolist()
        edges += [(first + i, first + i + 1) for i in range(len(points) - 1)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, edges, [])
    shape = bpy.data.objects.new(name, mesh)
    shape.hide_viewport = shape.hide_render = True
    collection.objects.link(shape)
    return shape
