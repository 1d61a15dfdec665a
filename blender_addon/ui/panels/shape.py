"""Body shape: what the body looks like, and ten sliders that move skin and joints together."""

from __future__ import annotations

import bpy

from ...body.shape import body_mesh, effect_of, look_key, sliders
from ..settings_layout import is_slim
from ..translation import CONTEXT
from .parts import StagePanel


class VIEW3D_PT_mocap_shape(StagePanel, bpy.types.Panel):
    """The shape of the solved body."""

    stage = "EDIT"
    bl_idname = "VIEW3D_PT_mocap_shape"
    bl_parent_id = "VIEW3D_PT_mocap_review"
    bl_label = "Body Shape"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 2

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there is a body with sliders."""
        armature = settings.review.armature
        return armature is not None and body_mesh(armature) is not None

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one slider a component."""
        mesh = body_mesh(context.scene.mocap.review.armature)
        assert mesh is not None  # polled
        if look_key(mesh) is not None:
            self.layout.row().prop(context.scene.mocap, "look", expand=True, text_ctxt=CONTEXT)
        column = self.layout.column(align=True)
        for key in sliders(mesh):
            effect = effect_of(key)
            if is_slim(context):
                column.label(text=effect, text_ctxt=CONTEXT)
                effect = ""
            column.prop(key, "value", text=effect, text_ctxt=CONTEXT, slider=True)
