"""An armature evaluated by itself: frames pass without the meshes and everything else of its scene."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def alone(armature: bpy.types.Object, scene: bpy.types.Scene) -> Iterator[tuple[bpy.types.Scene, bpy.types.Depsgraph]]:
    """Put an armature alone into a scene of its own, at another's frame rate, while the block runs."""
    stage = bpy.data.scenes.new(armature.name)
    stage.render.fps, stage.render.fps_base = scene.render.fps, scene.render.fps_base
    stage.collection.objects.link(armature)
    try:
        with bpy.context.temp_override(scene=stage, view_layer=stage.view_layers[0]):
            yield stage, bpy.context.evaluated_depsgraph_get()
    finally:
        bpy.data.scenes.remove(stage)
