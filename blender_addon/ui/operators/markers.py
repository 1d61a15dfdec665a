"""Naming a point: choose it in the viewport or the list, choose a name; the next solve keeps to it."""

from __future__ import annotations

import bpy

from .base import MocapOperator

_REACH_PX = 25.0
"""From the pointer to a point that is meant, pixels; chosen by hand."""


class _OfMarkers(MocapOperator):
    """Mixin of operators on a recording of markers."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs markers that are shown."""
        capture = context.scene.mocap.capture
        if capture.cloud is None or not capture.marker_items:
            cls.poll_message_set("Import a recording of markers first")
            return False
        return True


class MOCAP_OT_pick_point(_OfMarkers, bpy.types.Operator):
    """Chooses a point by a click."""

    bl_idname = "mocap.pick_point"
    bl_label = "Pick"
    bl_description = "Click a point in the viewport to choose it in the list"

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Wait for the click."""
        context.window.cursor_modal_set("EYEDROPPER")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take the nearest point to the click; let the view be turned meanwhile."""
        if event.type in ("ESC", "RIGHTMOUSE"):
            context.window.cursor_modal_restore()
            return {"CANCELLED"}
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        context.window.cursor_modal_restore()
        return self._picked(context, event)

    def _picked(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from ..viewport import name_places

        for area in context.screen.areas:
            region = next((r for r in area.regions if r.type == "WINDOW"), None)
            if area.type != "VIEW_3D" or region is None:
                continue
            x, y = event.mouse_x - region.x, event.mouse_y - region.y
            if not (0 <= x < region.width and 0 <= y < region.height):
                continue
            with context.temp_override(area=area, region=region, region_data=area.spaces.active.region_3d):
                places = name_places(bpy.context, context.scene.mocap.capture.cloud)
            return {"FINISHED"} if choose_nearest(context.scene.mocap.capture, places, x, y) else {"CANCELLED"}
        return {"CANCELLED"}


def choose_nearest(
    capture: bpy.types.PropertyGroup, places: dict[str, tuple[float, float]], x: float, y: float
) -> bool:
    """Choose the point within reach of a place of a region in the list; return whether there is one."""
    apart = {label: ((px - x) ** 2 + (py - y) ** 2) ** 0.5 for label, (px, py) in places.items()}
    label = min(apart, key=lambda name: apart[name], default=None)
    if label is None or apart[label] > _REACH_PX:
        return False
    capture.marker_index = capture.marker_items.find(label)
    return True


class MOCAP_OT_tell_point(_OfMarkers, bpy.types.Operator):
    """Names the chosen point."""

    bl_idname = "mocap.tell_point"
    bl_label = "Name Point"
    bl_description = "Name the chosen point on the current frame; Solve then labels the recording around it"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Keep the name."""
        from ...scene.marker_cloud import marker_positions
        from ...scene.point_player import played_row

        capture = context.scene.mocap.capture
        index = capture.marker_index
        if not 0 <= index < len(capture.marker_items):
            self.report({"ERROR"}, "Choose a point first, by Pick or in the list")
            return {"CANCELLED"}
        label, frame = capture.marker_items[index].name, context.scene.frame_current_final
        if label not in marker_positions(capture.cloud, frame):
            self.report({"ERROR"}, f"{label} is not seen on this frame; go to one that sees it")
            return {"CANCELLED"}
        row = played_row(capture.cloud, frame)
        item = next((item for item in capture.told if (item.point, item.frame) == (index, row)), None)
        item = item or capture.told.add()
        item.name, item.point, item.frame = label, index, row
        item.marker = "" if capture.told_name == "NONE" else capture.told_name
        return {"FINISHED"}


class MOCAP_OT_untell_point(MocapOperator, bpy.types.Operator):
    """Clears the label assigned to a point."""

    bl_idname = "mocap.untell_point"
    bl_label = "Forget Name"
    bl_description = "Clear the assigned label"

    index: bpy.props.IntProperty(options={"SKIP_SAVE"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Remove the name."""
        labels = context.scene.mocap.capture.told
        if 0 <= self.index < len(labels):
            labels.remove(self.index)
        return {"FINISHED"}
