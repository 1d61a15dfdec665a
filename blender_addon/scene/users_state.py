"""What in a scene is the user's: looked at before anything of it is changed, and restored where it must change."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

from ..conventions.timing import scene_frame_rate

_STARTUP = frozenset({"Cube", "Camera", "Light"})
"""Objects of the file that Blender starts with."""
_FACTORY = (24.0, 250, 1920, 1080, 100)
"""Frame rate, last frame and resolution of the file that Blender starts with."""


def is_untouched(scene: bpy.types.Scene) -> bool:
    """Return whether a scene is a new one as Blender starts with it, so that no choice of the user's can be lost."""
    render = scene.render
    size = render.resolution_x, render.resolution_y, render.resolution_percentage
    return (
        not bpy.data.filepath
        and (scene_frame_rate(scene), scene.frame_end, *size) == _FACTORY
        and {obj.name for obj in scene.objects} <= _STARTUP
        and not bpy.data.actions
    )


@contextmanager
def undisturbed(context: bpy.types.Context) -> Iterator[None]:
    """Work in object mode while the block runs; mode, selection and active object then are as they were."""
    layer = context.view_layer
    active, selected = layer.objects.active, list(context.selected_objects)
    mode = "OBJECT" if active is None else active.mode
    together = [obj for obj in layer.objects if mode != "OBJECT" and obj.mode == mode]
    if mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    try:
        yield
    finally:
        _select(layer, together, active)
        if mode != "OBJECT":
            bpy.ops.object.mode_set(mode=mode)
        _select(layer, selected, active)


def _select(layer: bpy.types.ViewLayer, chosen: list[bpy.types.Object], active: bpy.types.Object | None) -> None:
    for obj in layer.objects:
        if obj.select_get() != (obj in chosen):
            obj.select_set(obj in chosen)
    layer.objects.active = active
