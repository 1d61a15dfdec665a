"""Library overrides of what another file holds."""

from __future__ import annotations

import bpy


def override_linked(collection: bpy.types.Collection) -> bpy.types.Collection:
    """Put an editable override of a linked collection into the open scene, and return it.

    Blender 5 overrides only what the scene has had, so the linked one is there for a moment.
    """
    scene = bpy.context.scene
    scene.collection.children.link(collection)
    made = collection.override_hierarchy_create(scene, bpy.context.view_layer, do_fully_editable=True)
    scene.collection.children.unlink(collection)
    return made
