"""People: everybody that a capture shows, who of them is solved and reviewed, and *Solve All*."""

from __future__ import annotations

import bpy

from ..operators.solve_all import MOCAP_OT_solve_all
from ..properties import MocapCapture
from .parts import StagePanel


class MOCAP_UL_people(bpy.types.UIList):
    """One row a person."""

    bl_idname = "MOCAP_UL_people"

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: MocapCapture,
        item: bpy.types.PropertyGroup,
        icon: int,
        active_data: MocapCapture,
        active_property: str,
        index: int = 0,
        flt_flag: int = 0,
    ) -> None:
        """Draw name, whether they are solved, and how many views see them on average."""
        solved = data.review_of(index).take is not None
        row = layout.split(factor=0.6, align=True)
        row.prop(item, "name", text="", emboss=False, icon="OUTLINER_OB_ARMATURE" if solved else "USER")
        row.label(text=f"{item.views:.1f}", icon="CAMERA_DATA", translate=False)


class VIEW3D_PT_mocap_people(StagePanel, bpy.types.Panel):
    """Who is seen."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_people"
    bl_parent_id = "VIEW3D_PT_mocap_capture"
    bl_label = "People"
    bl_order = 2

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there are several people."""
        return bool(settings.capture.people)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the list."""
        layout, capture = self.layout, context.scene.mocap.capture
        rows = min(6, max(2, len(capture.people)))
        layout.template_list("MOCAP_UL_people", "", capture, "people", capture, "person_shown", rows=rows)
        person = capture.person
        if person is not None and capture.person_index != capture.person_shown:
            layout.label(text=f"Active body: {person.name}", icon="INFO", translate=False)


def draw_solve_all(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """Draw the buttons that solve everybody, where there are several people or captures."""
    column = layout.column(align=True)
    if settings.capture.people:
        text = f"Solve All {len(settings.capture.people)} People"
        column.operator(MOCAP_OT_solve_all.bl_idname, text=text, icon="COMMUNITY").scope = "CAPTURE"
    if len(settings.captures) > 1:
        text = f"Solve All {len(settings.captures)} Captures"
        column.operator(MOCAP_OT_solve_all.bl_idname, text=text, icon="SEQUENCE").scope = "SCENE"


CLASSES = (MOCAP_UL_people, VIEW3D_PT_mocap_people)
