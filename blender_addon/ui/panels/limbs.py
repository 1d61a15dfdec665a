"""Rig: each limb joint by joint or from its end."""

from __future__ import annotations

import bpy

from ...body.controls.limbs import LIMBS, ROOT, has_limbs
from ..operators.limbs import MOCAP_OT_switch_limbs
from ..settings_layout import is_narrow
from ..translation import CONTEXT
from .parts import StagePanel, wrapped

_SLIDER, _NARROW_SLIDER = 0.75, 0.82
"""Share of a line that a limb's slider has, also where the sidebar is narrow; the button beside it has the rest."""


class VIEW3D_PT_mocap_limbs(StagePanel, bpy.types.Panel):
    """The controls of the solved body."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_limbs"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "FK and IK"
    bl_order = 4

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a body with controls."""
        return has_limbs(settings.review.armature)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a switch a limb and, beside it, the button that keeps the motion."""
        layout = self.layout
        armature = context.scene.mocap.review.armature
        column = layout.column(align=True)
        share = _NARROW_SLIDER if is_narrow(context) else _SLIDER
        for limb in LIMBS:
            row = column.split(factor=share, align=True)
            row.prop(armature.pose.bones[ROOT], f'["{limb.switch}"]', text=limb.label, text_ctxt=CONTEXT, slider=True)
            to = "FK" if armature.pose.bones[ROOT][limb.switch] > 0 else "IK"
            _draw_switch(row, to, limb.switch, to)
        row = layout.row(align=True)
        _draw_switch(row, "IK", "ALL", "All to IK")
        _draw_switch(row, "FK", "ALL", "All to FK")
        wrapped(layout, context, "The buttons key the limbs so that the motion stays; the sliders only blend.", "INFO")


def _draw_switch(layout: bpy.types.UILayout, to: str, limb: str, text: str) -> None:
    button = layout.operator(MOCAP_OT_switch_limbs.bl_idname, text=text)
    button.to, button.limb = to, limb
