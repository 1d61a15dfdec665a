"""Drivers without the line that Blender gives each new one, which takes as much of a file as the driver itself."""

from __future__ import annotations

import bpy


def add_driver(owner: bpy.types.bpy_struct, path: str, axis: int = -1) -> bpy.types.Driver:
    """Return a new driver of a property, or of one element of an array, whose value goes over as it is."""
    return plain(owner.driver_add(path, axis))


def plain(curve: bpy.types.FCurve) -> bpy.types.Driver:
    """Return a driver's own, its curve without modifiers (before Blender 5) or keys: a value then stays as it is."""
    for modifier in tuple(curve.modifiers):
        curve.modifiers.remove(modifier)
    curve.keyframe_points.clear()
    return curve.driver
