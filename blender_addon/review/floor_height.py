"""The height of a body above the floor."""

from __future__ import annotations

import bpy
import numpy as np


def sole_height(
    scene: bpy.types.Scene, armature: bpy.types.Object, take: bpy.types.Action, samples: int
) -> float | None:
    """Return the median height of the lowest point of the skin, None without a skin.

    Args:
        scene: the scene, which keeps its current frame.
        samples: number of frames to use.

    Returns:
        Blender units.
    """
    skins = [obj for obj in scene.objects if obj.type == "MESH" and obj.find_armature() == armature]
    if not skins:
        return None
    shown = scene.frame_current_final
    first, last = take.frame_range
    lowest: list[float] = []
    try:
        for frame in np.linspace(first, last, samples):
            scene.frame_set(int(frame), subframe=float(frame % 1.0))
            lowest.append(min(_lowest(skin) for skin in skins))
    finally:
        scene.frame_set(int(shown // 1), subframe=float(shown % 1.0))
    return float(np.median(lowest))


def _lowest(skin: bpy.types.Object) -> float:
    posed = skin.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = posed.to_mesh()
    try:
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
    finally:
        posed.to_mesh_clear()
    world = np.array(posed.matrix_world)
    return float((points.reshape(-1, 3) @ world[2, :3] + world[2, 3]).min())
