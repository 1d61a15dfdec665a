"""That the scene's frame rate is not the one that everything is laid by: on top, in headers, and where it is set."""

from __future__ import annotations

import bpy

from ..operators.takes import MOCAP_OT_follow_rate, takes_of_captures
from .parts import wrapped


def is_laid_otherwise(scene: bpy.types.Scene) -> bool:
    """Return whether motion, detections or footage lie by another frame rate than the scene's."""
    from ...scene.frame_rate import needs_relaying

    return needs_relaying(scene, takes_of_captures(scene))


def draw_rate(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the notice and what to press, if there is anything to lay anew."""
    from ...conventions.timing import scene_frame_rate

    if not is_laid_otherwise(context.scene):
        return
    box = layout.box()
    text = f"The scene runs at {scene_frame_rate(context.scene):g} fps now: motion or detections play at a wrong speed."
    wrapped(box, context, text, "ERROR", alert=True)
    box.operator(MOCAP_OT_follow_rate.bl_idname, icon="TIME")


def draw_rate_button(self: bpy.types.Header | bpy.types.Panel, context: bpy.types.Context) -> None:
    """Draw the button alone, in red: in editors' headers, and below Blender's own frame rate."""
    if context.scene is None or not is_laid_otherwise(context.scene):
        return
    row = self.layout.row()
    row.alert = True
    row.operator(MOCAP_OT_follow_rate.bl_idname, icon="ERROR")


HEADERS = ("VIEW3D_HT_header", "DOPESHEET_HT_header", "GRAPH_HT_header", "RENDER_PT_format")
"""Where an animator looks, and where the frame rate is set."""
