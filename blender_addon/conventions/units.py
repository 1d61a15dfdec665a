"""Metres in scenes of any unit scale."""

from __future__ import annotations

from collections.abc import Iterable

import bpy


def fit_units(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> None:
    """Scale objects that were built in metres to a scene whose Blender unit is not one; children follow."""
    scale = 1.0 / scene.unit_settings.scale_length
    if abs(scale - 1.0) < 1e-6:
        return
    for obj in objects:
        if obj.parent is None:
            obj.location = [scale * value for value in obj.location]
            obj.scale = [scale * value for value in obj.scale]
        if obj.type == "CAMERA":
            obj.data.clip_start, obj.data.clip_end = scale * obj.data.clip_start, scale * obj.data.clip_end
