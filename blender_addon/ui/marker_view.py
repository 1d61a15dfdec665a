"""Markers in the viewport: their names beside them, and their colours by the current take's residuals."""

from __future__ import annotations

from typing import Any

import bpy

_OFFSET_PX = 7
"""From a point to its name, pixels; chosen by hand."""
_SIZE_PX = 11
"""Height of a name, pixels: that of Blender's own texts."""
_PLAIN, _DOUBTFUL = (0.9, 0.9, 0.95, 1.0), (1.0, 0.5, 0.2, 1.0)


class NameDrawing:
    """The viewports' draw handler, there while the add-on is switched on."""

    def __init__(self) -> None:
        self._handle: Any = None

    def start(self) -> None:
        """Draw from now on."""
        self._handle = bpy.types.SpaceView3D.draw_handler_add(draw_names, (), "WINDOW", "POST_PIXEL")

    def stop(self) -> None:
        """Draw no longer."""
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")


drawing = NameDrawing()


def draw_names() -> None:
    """Draw the names of the scene's markers into the viewport being drawn; one that no layout knows stands out."""
    for capture in bpy.context.scene.mocap.captures:
        if capture.show_names and capture.cloud is not None and capture.cloud.visible_get():
            _draw_names(bpy.context, capture)


def _draw_names(context: bpy.types.Context, capture: bpy.types.PropertyGroup) -> None:
    import blf

    scale = context.preferences.system.ui_scale
    known = {item.name for item in capture.marker_items if item.meaning == "known"}
    blf.size(0, _SIZE_PX * scale)
    for label, (x, y) in name_places(context, capture.cloud).items():
        blf.color(0, *(_PLAIN if label in known else _DOUBTFUL))
        blf.position(0, x + _OFFSET_PX * scale, y, 0)
        blf.draw(0, label.rpartition(":")[2])


def name_places(context: bpy.types.Context, cloud: bpy.types.Object) -> dict[str, tuple[float, float]]:
    """Return where in a viewport's region the markers of the current frame are, by label."""
    from bpy_extras.view3d_utils import location_3d_to_region_2d
    from mathutils import Vector

    from ..scene.marker_cloud import marker_positions

    found = {}
    for label, point in marker_positions(cloud, context.scene.frame_current_final).items():
        place = location_3d_to_region_2d(context.region, context.region_data, cloud.matrix_world @ Vector(point))
        if place is not None:
            found[label] = (place.x, place.y)
    return found


def colour_markers(scene: bpy.types.Scene) -> None:
    """Colour the scene's markers by how far the take that the body plays is from them, or as recorded."""
    capture, take = scene.mocap.capture, scene.mocap.review.take
    if capture.cloud is None:
        return
    from .._exchange.errors import MocapError
    from .._exchange.motion_file import read_motion
    from ..animation.takes import take_file
    from ..scene.marker_cloud import grade_markers

    motion = None
    if capture.show_residuals and take is not None:
        try:
            motion = read_motion(take_file(take, "motion_file"))
        except MocapError:
            motion = None  # the take's file is gone: markers as recorded
    grade_markers(capture.cloud, motion)
