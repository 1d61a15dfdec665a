"""Name points of a marker recording, which the next solve keeps to."""

from __future__ import annotations

from typing import Any

import bpy

from .base import MARKERS, MocapOperator, Need, operator

_REACH_PX = 25.0
"""Maximum distance of a click from a point, chosen by hand."""
_SHOWN = Need(MARKERS.message, lambda context: context.scene.mocap.capture.cloud is not None)


class MOCAP_OT_pick_point(MocapOperator, bpy.types.Operator):
    """Select a point with a click in the viewport."""

    bl_label = "Pick"
    needs = (MARKERS, _SHOWN)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window.cursor_modal_set("EYEDROPPER")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Select the point nearest to the click, and let the user move the view before."""
        is_click = event.type == "LEFTMOUSE" and event.value == "PRESS"
        if not is_click and event.type not in ("ESC", "RIGHTMOUSE"):
            return {"PASS_THROUGH"}
        context.window.cursor_modal_restore()
        return {"FINISHED"} if is_click and _pick(context, event) else {"CANCELLED"}


def _pick(context: bpy.types.Context, event: bpy.types.Event) -> bool:
    from ..viewport import name_places

    for area in context.screen.areas:
        region = next((r for r in area.regions if r.type == "WINDOW"), None)
        if area.type != "VIEW_3D" or region is None:
            continue
        x, y = event.mouse_x - region.x, event.mouse_y - region.y
        if 0 <= x < region.width and 0 <= y < region.height:
            with context.temp_override(area=area, region=region, region_data=area.spaces.active.region_3d):
                places = name_places(bpy.context, context.scene.mocap.capture.cloud)
            return choose_nearest(context.scene.mocap.capture, places, x, y)
    return False


def choose_nearest(
    capture: bpy.types.PropertyGroup, places: dict[str, tuple[float, float]], x: float, y: float
) -> bool:
    """Select the point nearest to a position in a region, and return whether one is within reach."""
    apart = {label: ((px - x) ** 2 + (py - y) ** 2) ** 0.5 for label, (px, py) in places.items()}
    label = min(apart, key=lambda name: apart[name], default=None)
    if label is None or apart[label] > _REACH_PX:
        return False
    capture.marker_index = capture.marker_items.find(label)
    return True


@operator("Label Point", MARKERS, _SHOWN)
def label_point(self: Any, context: bpy.types.Context) -> set[str] | None:
    """Label the selected point in this frame, so that the next solve labels the recording around it."""
    from ...scene.marker_cloud import marker_positions, played_row

    capture = context.scene.mocap.capture
    index = capture.marker_index
    if not 0 <= index < len(capture.marker_items):
        return self.give_up("Select a point first, with Pick or in the list", "ERROR")
    label, frame = capture.marker_items[index].name, context.scene.frame_current_final
    if label not in marker_positions(capture.cloud, frame):
        return self.give_up(f"{label} is not visible in this frame; go to a frame with this point", "ERROR")
    row = played_row(capture.cloud, frame)
    item = next((item for item in capture.point_labels if (item.point, item.frame) == (index, row)), None)
    item = item or capture.point_labels.add()
    item.name, item.point, item.frame = label, index, row
    item.marker = "" if capture.label_name == "NONE" else capture.label_name
    return None


@operator("Remove Label", index=int)
def remove_point_label(self: Any, context: bpy.types.Context) -> None:
    """Remove the label from this point."""
    labels = context.scene.mocap.capture.point_labels
    if 0 <= self.index < len(labels):
        labels.remove(self.index)
