"""Tag objects and collections, so that captures find the objects that belong to them.

A pointer in the scene would keep a deleted object alive.
"""

from __future__ import annotations

from secrets import token_hex

import bpy

TAG = "mocap_tag"  # Custom property of an object or collection. Captures store its value.
_names: dict[str, str] = {}  # Last known object name per tag, tried first as a scene may have thousands of objects.


def tag_of(owner: bpy.types.ID | None) -> str:
    """Return the tag of an object or collection, or "" if it has none."""
    if owner is None:
        return ""
    return owner.get(TAG, "" if owner.library is None else owner.name_full)


def give_tag(owner: bpy.types.ID | None) -> str:
    """Return the tag of an object or collection, creating it if needed. Return "" for None."""
    tag = tag_of(owner)
    if owner is not None and not tag:
        tag = owner[TAG] = token_hex(16)
    return tag


def _find_object(scene: bpy.types.Scene, tag: str) -> bpy.types.Object | None:
    if not tag:
        return None
    known = scene.objects.get(_names.get(tag, ""))
    if known is not None and known.library is None and tag_of(known) == tag:
        return known
    found = [obj for obj in scene.objects if tag_of(obj) == tag]
    chosen = next((obj for obj in found if obj.library is None), found[0] if found else None)
    if chosen is not None:
        _names[tag] = chosen.name
    return chosen


def find_collection(scene: bpy.types.Scene, tag: str) -> bpy.types.Collection | None:
    """Return the scene collection that has a tag, or None if it was deleted."""
    return next((child for child in scene.collection.children_recursive if tag_of(child) == tag), None) if tag else None


def active_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return a scene's active object, taken from the window's view layer if the window shows the scene."""
    shown = getattr(bpy.context, "scene", None) == scene
    layer = bpy.context.view_layer if shown else scene.view_layers[0]
    return layer.objects.active if layer is not None else None


def active_name(scene: bpy.types.Scene) -> str:
    """Return the full name of a scene's active object, or "" if there is none."""
    active = active_object(scene)
    return "" if active is None else active.name_full


class TaggedObject:
    """Property that finds an object by its tag. It can prefer the active object or its armature."""

    def __init__(self, key: str, *, prefer_active: bool = False) -> None:
        self._key, self._prefer_active = key, prefer_active

    def __get__(self, group: bpy.types.PropertyGroup | None, owner: type) -> bpy.types.Object | None:
        if group is None:
            return None
        tag, scene = getattr(group, self._key), group.id_data
        active = active_object(scene) if tag and self._prefer_active else None
        for obj in (active, active and active.find_armature()):
            if obj is not None and tag_of(obj) == tag and scene.objects.get(obj.name) is not None:
                return obj
        return _find_object(scene, tag)

    def __set__(self, group: bpy.types.PropertyGroup, obj: bpy.types.Object | None) -> None:
        setattr(group, self._key, give_tag(obj))
