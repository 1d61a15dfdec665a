"""Characters as files of other programs: a skin over foreign bones, written by Blender's exporters and read again."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import bpy
import numpy as np

from tests.support.foreign_rigs import foreign_rig
from tests.support.foreign_skeletons import ForeignSkeleton

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
_HALF_M = 0.03
"""Half the edge of the box that is each bone's skin."""


def skinned_rig(skeleton: ForeignSkeleton, *, unit: float = 1.0, sole: float = 0.0) -> bpy.types.Object:
    """Build an armature whose mesh has a box about the head of every bone; those of the feet stand on their sole.

    Args:
        skeleton: its bones.
        unit: scale of the armature object; bones and mesh are so much smaller inside.
        sole: height of the lowest vertices in metres.
    """
    rig, _ = foreign_rig(skeleton, unit=unit)
    feet = {skeleton.roles[f"{side}_foot"] for side in ("left", "right")}
    points, faces, names = [], [], []
    for bone, head in skeleton.heads.items():
        box = head + _HALF_M * _CORNERS
        if bone in feet:
            box[box[:, 2] < head[2], 2] = sole
        box[:, 2] = np.maximum(box[:, 2], sole)
        faces += [tuple(len(points) + corner for corner in face) for face in _FACES]
        points += (box / unit).tolist()
        names += [bone] * len(box)
    mesh = bpy.data.meshes.new("Skin")
    mesh.from_pydata(points, [], faces)
    skin = bpy.data.objects.new("Skin", mesh)
    bpy.context.scene.collection.objects.link(skin)
    skin.parent = rig
    for v, name in enumerate(names):
        (skin.vertex_groups.get(name) or skin.vertex_groups.new(name=name)).add([v], 1.0, "REPLACE")
    skin.modifiers.new("Armature", "ARMATURE").object = rig
    bpy.context.view_layer.update()
    return rig


def write_character(path: Path, skeleton: ForeignSkeleton, *, unit: float = 1.0, sole: float = 0.0) -> Path:
    """Write a character in a new file of the format that the name ends on; what was open is lost."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    rig = skinned_rig(skeleton, unit=unit, sole=sole)
    if path.suffix == ".fbx":
        bpy.ops.export_scene.fbx(filepath=str(path), add_leaf_bones=False, bake_anim=rig.animation_data is not None)
    elif path.suffix == ".blend":
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    else:
        glb = path.with_suffix(".glb")
        bpy.ops.export_scene.gltf(filepath=str(glb), export_animations=False)
        if path != glb:
            state_humanoid_in(glb, skeleton).rename(path)
    return path


_VRM_NAMES = {
    "pelvis": "hips", "spine_1": "spine", "spine_2": "chest", "neck_1": "neck", "head": "head",
    **{f"{side}_{role}": f"{side}{human}" for side in ("left", "right") for role, human in (
        ("clavicle", "Shoulder"), ("upper_arm", "UpperArm"), ("forearm", "LowerArm"), ("hand", "Hand"),
        ("thigh", "UpperLeg"), ("shin", "LowerLeg"), ("foot", "Foot"), ("toe", "Toes"))},
}  # fmt: skip


def state_humanoid_in(path: Path, skeleton: ForeignSkeleton, extension: str = "VRMC_vrm") -> Path:
    """Add VRM 1.0's humanoid to the header of a GLB file. A VRM animation has nodes without skins."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    header = json.loads(data[20 : 20 + length])
    nodes = {node.get("name"): n for n, node in enumerate(header["nodes"])}
    bones = {
        human: {"node": nodes[skeleton.roles[role]]} for role, human in _VRM_NAMES.items() if role in skeleton.roles
    }
    header["extensions"] = {extension: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    header["extensionsUsed"] = [*header.get("extensionsUsed", []), extension]
    if extension != "VRMC_vrm":
        header.pop("skins", None)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<III", 0x46546C67, 2, 20 + len(text) + len(rest)) + struct.pack("<II", len(text), 0x4E4F534A)
    path.write_bytes(head + text + rest)
    return path
