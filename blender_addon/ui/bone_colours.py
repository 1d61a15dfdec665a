"""Bones painted by confidence, repainted on every frame."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

_ACTIVE_BLEND, _SELECT_BLEND = 0.65, 0.35
_VISIBLE = 0.02
"""Least change of a colour that is shown."""


def colour_bones(scene: bpy.types.Scene) -> None:
    """Paint the bones of the scene's body by their joints' confidence, or take the paint off."""
    from ..review.confidence import colours
    from ..review.confidence_lane import confidence_at

    review = scene.mocap.review
    armature = review.armature
    if armature is None or armature.type != "ARMATURE":
        return
    action = armature.animation_data.action if armature.animation_data is not None else None
    confidence = confidence_at(action, scene.frame_current) if action is not None else {}
    if not confidence:
        return
    if not review.colours:
        for name in confidence:
            armature.pose.bones[name].color.palette = "DEFAULT"
        return
    painted = colours(list(confidence.values()))
    for name, colour in zip(confidence, painted, strict=True):
        target = armature.pose.bones[name].color
        if target.palette != "CUSTOM":
            target.palette = "CUSTOM"
        elif max(abs(colour - target.custom.normal)) < _VISIBLE:
            continue  # every change has Blender redraw its editors
        target.custom.normal = colour
        target.custom.select = colour + _SELECT_BLEND * (1 - colour)
        target.custom.active = colour + _ACTIVE_BLEND * (1 - colour)


@persistent
def on_frame_change(scene: bpy.types.Scene, *_: object) -> None:
    """Repaint before the new frame is evaluated, so that it is evaluated once; nothing is done with colours off."""
    if scene.mocap.review.colours and not bpy.app.is_job_running("RENDER"):
        colour_bones(scene)
