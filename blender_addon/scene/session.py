"""A fresh Blender file for a take: light, a world, and viewports that look at it."""

from __future__ import annotations

import os
from pathlib import Path

import bpy
from mathutils import Vector

from .._exchange.errors import OutputNotWritable

_WORLD = (0.24, 0.25, 0.28)
"""Linear red, green and blue of the light from everywhere; chosen by hand."""
_SUN_W_M2, _SUN_TURN = 3.0, (0.75, 0.15, 0.6)
_DISTANCE_M = 5.5
"""From the viewport's eye to the body, metres; chosen by hand."""
_CAUSELESS = "Failed to write blendfile"
"""What Blender 5 reports where its writing fails half-way."""


def fresh_scene() -> bpy.types.Scene:
    """Forget the open file and return an empty scene with a sun and a grey world, so that renders show something."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = _WORLD
    light = bpy.data.lights.new("Sun", "SUN")
    light.energy = _SUN_W_M2
    sun = bpy.data.objects.new("Sun", light)
    sun.location, sun.rotation_euler = (0.0, 0.0, 4.0), _SUN_TURN
    scene.collection.objects.link(sun)
    return scene


def frame_viewports(target: tuple[float, float, float]) -> None:
    """Turn every 3D viewport of the file to a point, a few metres away, with plain studio light.

    Args:
        target: world metres.
    """
    for screen in bpy.data.screens:
        for area in screen.areas:
            if area.type == "VIEW_3D":
                space = area.spaces.active
                space.region_3d.view_location = Vector(target)
                space.region_3d.view_distance = _DISTANCE_M
                space.shading.color_type = "MATERIAL"


def save_file(path: Path) -> None:
    """Save a compressed copy of the open file.

    Raises:
        OutputNotWritable: Blender cannot write it.
    """
    try:
        bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath(path), compress=True, copy=True)
    except RuntimeError as error:
        hint = "Choose a folder you may write to, with enough free space."
        raise OutputNotWritable(
            f"Blender cannot save the file: {why_not_written(error)}.", where=path.name, hint=hint
        ) from error


def why_not_written(error: Exception) -> str:
    """Return what Blender reports of a file that it cannot write.

    Blender 5 writes no cause behind its own words, but "Success" or a stray byte (5.3).
    """
    text = str(error).strip().removeprefix("Error: ").rstrip(".")
    return "Blender stopped in the middle of the file; the disk may be full" if text.startswith(_CAUSELESS) else text
