"""Rig: each limb joint by joint or from its end."""

from __future__ import annotations

import bpy

from ...body.controls.limbs import LIMBS, ROOT, has_limbs
from ..operators.limbs import MOCAP_OT_limbs_to_fk, MOCAP_OT_limbs_to_ik
from .parts import MocapPanel, wrapped


class VIEW3D_PT_mocap_limbs(MocapPanel, bpy.types.Panel):
    """The controls of the solved body."""

    bl_idname = "VIEW3D_PT_mocap_limbs"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "FK and IK"
    bl_order = 4

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a body with controls."""
        return has_limbs(context.scene.mocap.review.armature)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a switch a limb and, beside it, the way there with the motion kept."""
        layout = self.layout
        armature = context.scene.mocap.review.armature
        column = layout.column(align=True)
        for limb in LIMBS:
            row = column.row(align=True)
            on = armature.pose.bones[ROOT][limb.switch] > 0
            row.prop(armature.pose.bones[ROOT], f'["{limb.switch}"]', text=limb.label, slider=True, translate=True)
            way = MOCAP_OT_limbs_to_fk if on else MOCAP_OT_limbs_to_ik
            row.operator(way.bl_idname, text="FK" if on else "IK", translate=False).limb = limb.switch
        row = layout.row(align=True)
        row.operator(MOCAP_OT_limbs_to_ik.bl_idname, text="All to IK").limb = "ALL"
        row.operator(MOCAP_OT_limbs_to_fk.bl_idname, text="All to FK").limb = "ALL"
        wrapped(layout, context, "The buttons key the limbs so that the motion stays; the sliders only blend.", "INFO")
