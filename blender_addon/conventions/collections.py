"""Collections that keep what belongs together."""

from __future__ import annotations

import bpy


def child_collection(name: str, parent: bpy.types.Collection) -> bpy.types.Collection:
    """Create a collection inside another one."""
    collection = bpy.data.collections.new(name)
    parent.children.link(collection)
    return collection
