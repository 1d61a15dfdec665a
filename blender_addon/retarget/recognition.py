"""Recognition of a rig in Blender: the humanoid map that its file carries, else what its bones show."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import bpy

from .._exchange.rigs.skeleton import Skeleton
from .maps.presets import choose_map
from .maps.rig_map import RigMap
from .maps.vrm import roles_of_vrm

_VRM = "vrm_addon_extension"
"""Custom property in which the VRM add-on keeps a file's humanoid."""
_STATED = "stated_humanoid"
"""Custom property in which we keep it: bone by VRM's name, as JSON."""


def map_rig(armature: bpy.types.Object, user_folder: Path | None = None) -> RigMap:
    """Return the map of a rig: a VRM's own, a preset that fits, or what structure and names indicate.

    Args:
        armature: the rig.
        user_folder: where the user's presets are.
    """
    bones = armature.data.bones
    if stated := roles_of_vrm(_stated_bones(armature), bones.keys()):
        return RigMap("VRM humanoid of the file", stated)
    heads = {bone.name: tuple(bone.head_local) for bone in bones}
    parents = {bone.name: bone.parent.name for bone in bones if bone.parent is not None}
    return choose_map(Skeleton(heads, parents), user_folder)


def state_humanoid(armature: bpy.types.Object, bones: Mapping[str, str]) -> None:
    """Keep with an armature the bone by VRM's name of it that its file states."""
    if any(bone in armature.data.bones for bone in bones.values()):
        armature.data[_STATED] = json.dumps(dict(bones))


def _stated_bones(armature: bpy.types.Object) -> dict[str, str]:
    """Return the bone by name of VRM's humanoid, from the file or what the VRM add-on keeps; it need not be enabled."""
    kept = armature.data.get(_STATED)
    if isinstance(kept, str):
        return json.loads(kept)
    kept = armature.data.get(_VRM)
    if not hasattr(kept, "get"):
        return {}
    found = dict(_humans_of_vrm1(kept))
    return found or dict(_humans_of_vrm0(kept))


def _humans_of_vrm1(kept: Mapping) -> Iterator[tuple[str, str]]:
    for human, entry in _at(kept, "vrm1", "humanoid", "human_bones").items():
        if name := _at(entry, "node").get("bone_name", ""):
            yield human, str(name)


def _humans_of_vrm0(kept: Mapping) -> Iterator[tuple[str, str]]:
    for entry in _at(kept, "vrm0", "humanoid").get("human_bones", []):
        if name := _at(entry, "node").get("bone_name", ""):
            yield str(entry.get("bone", "")), str(name)


def _at(value: Mapping, *keys: str) -> Mapping:
    for key in keys:
        value = value.get(key, {}) if hasattr(value, "get") else {}
    return value if hasattr(value, "get") else {}
