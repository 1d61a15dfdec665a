"""Fingers: those of gloves, a curl and a spread a finger, and a fist a hand."""

from __future__ import annotations

import bpy

from ..._exchange.hand_points import FINGERS, SIDES
from ...body.controls.limbs import finger_control, fist_control, has_finger_controls
from ..operators.add_gloves import MOCAP_OT_add_gloves
from ..operators.solver_operator import current
from ..translation import CONTEXT
from .parts import StagePanel, wrapped

_CURL, _SPREAD = 0, 2
"""Axes of a control by which it curls and spreads."""


class VIEW3D_PT_mocap_fingers(StagePanel, bpy.types.Panel):
    """The fingers of the solved body."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_fingers"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "Fingers"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 5

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a take, or a body with finger controls."""
        return settings.review.take is not None or has_finger_controls(settings.review.armature)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what adds fingers, and the controls of both hands where the body has them."""
        column = self.layout.column()
        column.enabled = not current.busy
        column.operator(MOCAP_OT_add_gloves.bl_idname, icon="VIEW_PAN")
        armature = context.scene.mocap.review.armature
        if has_finger_controls(armature):
            self._draw_controls(context, armature.pose.bones)

    def _draw_controls(self, context: bpy.types.Context, bones: bpy.types.bpy_prop_collection) -> None:
        for side in SIDES:
            column = self.layout.column(align=True)
            column.label(text=f"{side.title()} Hand", text_ctxt=CONTEXT)
            rows = [("Fist", fist_control(side)), *((f.title(), finger_control(side, f)) for f in FINGERS)]
            for label, name in rows:
                row = column.row(align=True)
                row.prop(bones[name], "rotation_euler", index=_CURL, text=label, text_ctxt=CONTEXT)
                row.prop(bones[name], "rotation_euler", index=_SPREAD, text="Spread", text_ctxt=CONTEXT)
        wrapped(self.layout, context, "Controls add to what the finger bones are keyed to.", "INFO")
