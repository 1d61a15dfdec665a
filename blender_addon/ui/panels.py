"""The sidebar tab."""

import bpy

from .import_motion import MOCAP_OT_import_motion


class VIEW3D_PT_mocap(bpy.types.Panel):
    """Solved motions in and out of the scene."""

    bl_idname = "VIEW3D_PT_mocap"
    bl_label = "Manifold MoCap"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "MoCap"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the button, and what the selected body's motion is."""
        self.layout.operator(MOCAP_OT_import_motion.bl_idname, icon="ARMATURE_DATA")
        obj = context.object
        action = obj.animation_data.action if obj is not None and obj.animation_data is not None else None
        if action is not None and "provenance" in action:
            box = self.layout.box()
            box.label(text=action.name, icon="ACTION")
            box.label(text=f"{action['fps']:g} fps, body '{action['body']}'")
