"""Markers: what the labels mean, gaps, and how the points are shown."""

from __future__ import annotations

import bpy

from ...conventions.naming import counted
from ..operators.tell_points import MOCAP_OT_pick_point, MOCAP_OT_tell_point, MOCAP_OT_untell_point
from ..properties import MocapCapture
from .parts import StagePanel, wrapped

_ICONS = {
    "known": "CHECKMARK", "unknown": "QUESTION", "computed": "EMPTY_AXIS", "doubled": "DUPLICATE", "unlabelled": "DOT",
}  # fmt: skip


class MOCAP_UL_markers(bpy.types.UIList):
    """The capture's markers, a row each."""

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: bpy.types.AnyType,
        item: bpy.types.PropertyGroup,
        icon: int,
        active_data: bpy.types.AnyType,
        active_property: str,
    ) -> None:
        """Draw label, meaning and gaps."""
        row = layout.row()
        row.label(text=item.name.rpartition(":")[2], icon=_ICONS[item.meaning], translate=False)
        gaps = row.row()
        gaps.alignment = "RIGHT"
        if item.gaps:
            gaps.label(text=f"{counted(item.gaps, 'gap')}, {item.missing_percent:.1f} %", translate=False)


class MarkersPanel(StagePanel):
    """A panel about the capture's markers."""

    stage = "CAPTURE"
    bl_parent_id = "VIEW3D_PT_mocap_capture"

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there are markers."""
        return bool(settings.capture.marker_items)


class VIEW3D_PT_mocap_markers(MarkersPanel, bpy.types.Panel):
    """The capture's markers."""

    bl_idname = "VIEW3D_PT_mocap_markers"
    bl_label = "Markers"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what was recognised, the markers, and how they are shown."""
        layout, capture = self.layout, context.scene.mocap.capture
        for line in recognised(capture):
            wrapped(layout, context, line)
        for message in capture.messages:
            if not message.is_problem:
                wrapped(layout, context, message.text, "DOT")
        row = layout.row(align=True)
        row.prop(capture, "show_names", icon="FONT_DATA")
        colours = row.row(align=True)
        colours.enabled = context.scene.mocap.review.take is not None
        colours.prop(capture, "show_residuals", icon="COLOR")


class VIEW3D_PT_mocap_labels(MarkersPanel, bpy.types.Panel):
    """The capture's markers, one by one."""

    bl_idname = "VIEW3D_PT_mocap_labels"
    bl_label = "Labels"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the list."""
        capture = context.scene.mocap.capture
        self.layout.template_list(
            MOCAP_UL_markers.__name__, "", capture, "marker_items", capture, "marker_index", rows=6, maxrows=12
        )
        if 0 <= capture.marker_index < len(capture.marker_items):
            self.layout.prop(capture.marker_items[capture.marker_index], "bone")
        self._draw_labels(capture)

    def _draw_labels(self, capture: MocapCapture) -> None:
        """Draw the labels assigned to points: the solve labels the others around them."""
        column = self.layout.column(align=True)
        row = column.row(align=True)
        row.operator(MOCAP_OT_pick_point.bl_idname, icon="EYEDROPPER")
        row.prop(capture, "told_name", text="")
        row.operator(MOCAP_OT_tell_point.bl_idname, text="", icon="CHECKMARK")
        for index, item in enumerate(capture.told):
            line = column.row(align=True)
            text = f"{item.name} from frame {item.frame + capture.frame_start}: {item.marker or 'no marker'}"
            line.label(text=text, icon="DOT", translate=False)
            line.operator(MOCAP_OT_untell_point.bl_idname, text="", icon="X").index = index


def recognised(capture: MocapCapture) -> list[str]:
    """Return what is known about the markers of a capture: how many of which kind, subjects, gaps."""
    items = list(capture.marker_items)
    counts = {kind: sum(item.meaning == kind for item in items) for kind in _ICONS}
    lines = [", ".join(f"{count} {kind}" for kind, count in counts.items() if count)]
    if capture.subjects:
        lines.append(f"Subjects: {capture.subjects}")
    gaps = [item for item in items if item.gaps]
    if gaps:
        worst = max(gaps, key=lambda item: item.missing_percent)
        label = worst.name.rpartition(":")[2]
        count = counted(sum(item.gaps for item in gaps), "gap")
        lines.append(
            f"{count} in {counted(len(gaps), 'marker')}; most in {label}, which "
            f"{worst.missing_percent:.0f} % of the frames do not see"
        )
    return lines
