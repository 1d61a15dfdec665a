"""Files of the version that pointed to objects: what is in the scene is tagged instead, and the pointers go."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

_CHOSEN_AT = ("shown_at", "person_at")
"""Objects that were active when a capture or a person was chosen; nothing belongs to these."""
_OF_GROUPS = {
    "captures": ("cloud", "floor", "collection", "person_at"),
    "cameras": ("object", "detections"),
    "reviews": ("armature",),
}
"""Names of the pointers that the version before kept in each kind of group."""


def release_pointers(scene: bpy.types.Scene) -> None:
    """Tag what the pointers of the version before show in a scene, and remove them."""
    for group, names in _groups(scene):
        kept = _stored(group)
        if kept is None:
            continue
        for name in names:
            pointed = kept.get(name, None)
            if not isinstance(pointed, bpy.types.ID):
                continue  # it was None
            del kept[name]
            if _is_in(scene, pointed) and name not in _CHOSEN_AT:
                setattr(group, name, pointed)
    if hasattr(scene, "bl_system_properties_get"):
        _let_go(scene.get("mocap"))


def _let_go(kept: Any) -> None:
    """Remove pointers from the copy that Blender 5 leaves among custom properties: what is deleted would stay."""
    if isinstance(kept, list):
        for part in kept:
            _let_go(part)
    elif hasattr(kept, "keys"):
        for name in list(kept.keys()):
            if isinstance(kept[name], bpy.types.ID):
                del kept[name]
            else:
                _let_go(kept[name])


def _groups(scene: bpy.types.Scene) -> Iterator[tuple[bpy.types.PropertyGroup, tuple[str, ...]]]:
    yield scene.mocap, ("shown_at",)
    for capture in scene.mocap.captures:
        yield capture, _OF_GROUPS["captures"]
        for camera in capture.cameras:
            yield camera, _OF_GROUPS["cameras"]
        for review in capture.reviews:
            yield review, _OF_GROUPS["reviews"]


def _stored(group: bpy.types.PropertyGroup) -> bpy.types.PropertyGroup | None:
    """Return what keeps a group's values by name; since Blender 5.0 that is apart from custom properties."""
    return group.bl_system_properties_get() if hasattr(group, "bl_system_properties_get") else group


def _is_in(scene: bpy.types.Scene, pointed: bpy.types.ID) -> bool:
    if isinstance(pointed, bpy.types.Collection):
        return pointed in scene.collection.children_recursive
    return isinstance(pointed, bpy.types.Object) and scene in pointed.users_scene
