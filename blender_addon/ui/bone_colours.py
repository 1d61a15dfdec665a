"""The scene's body painted by confidence, repainted on every frame."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent


def colour_bones(scene: bpy.types.Scene) -> None:
    """Paint the bones of the scene's bodies by their joints' confidence, or take the paint off."""
    from ..review.bone_colours import paint_bones

    for capture in scene.mocap.captures:
        for review in capture.reviews:
            if review.armature is not None and review.armature.type == "ARMATURE":
                paint_bones(review.armature, scene.frame_current, shown=review.colours)


@persistent
def on_frame_change(scene: bpy.types.Scene, *_: object) -> None:
    """Repaint before the new frame is evaluated, so that it is evaluated once; nothing is done with colours off."""
    colours = any(review.colours for capture in scene.mocap.captures for review in capture.reviews)
    if colours and not bpy.app.is_job_running("RENDER"):
        colour_bones(scene)
