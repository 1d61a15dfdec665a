"""Capture cameras outlined in the viewport by what was found: green where nothing is doubtful, orange, grey unused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import bpy

if TYPE_CHECKING:
    from mathutils import Vector

SURE, DOUBTFUL, UNUSED = (0.25, 0.8, 0.35, 1.0), (1.0, 0.5, 0.2, 1.0), (0.5, 0.5, 0.5, 0.6)
"""Colours, as markers have them."""
_WIDTH_PX = 2.0
_EDGES = (0, 1, 1, 2, 2, 3, 3, 0)
"""Of the picture's corners."""


class CameraDrawing:
    """The viewports' draw handler, there while the add-on is switched on."""

    def __init__(self) -> None:
        self._handle: Any = None

    def start(self) -> None:
        """Draw from now on."""
        self._handle = bpy.types.SpaceView3D.draw_handler_add(draw_cameras, (), "WINDOW", "POST_VIEW")

    def stop(self) -> None:
        """Draw no longer."""
        bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")


drawing = CameraDrawing()


def draw_cameras() -> None:
    """Draw the outlines of the scene's capture cameras into the viewport being drawn."""
    import gpu  # pyright: ignore[reportMissingImports]
    from gpu_extras.batch import batch_for_shader  # pyright: ignore[reportMissingImports]

    context = bpy.context
    for camera, shade in shaded_cameras(context):
        shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
        shader.uniform_float("viewportSize", (context.region.width, context.region.height))
        shader.uniform_float("lineWidth", _WIDTH_PX * context.preferences.system.ui_scale)
        shader.uniform_float("color", shade)
        batch_for_shader(shader, "LINES", {"pos": outline(camera, context.scene)}).draw(shader)


def shaded_cameras(context: bpy.types.Context) -> Iterator[tuple[bpy.types.Object, tuple[float, ...]]]:
    """Yield the visible cameras of captures whose agreement is shown, but the one that is looked through."""
    for capture in context.scene.mocap.captures:
        for item in capture.cameras if capture.show_agreement else ():
            camera = item.object
            if camera is not None and camera.visible_get() and camera != context.scene.camera:
                yield camera, shade_of(capture, item)


def shade_of(capture: bpy.types.PropertyGroup, item: bpy.types.PropertyGroup) -> tuple[float, ...]:
    """Return the colour of a camera: by whether it is used, and whether a problem or a check names it."""
    if not item.use:
        return UNUSED
    named = [message.cameras for message in capture.messages if message.is_problem] + [capture.doubted]
    return DOUBTFUL if any(item.name in names.split("\n") for names in named) else SURE


def outline(camera: bpy.types.Object, scene: bpy.types.Scene) -> list[Vector]:
    """Return the ends of the lines of a camera's picture and of its edges to it, in the world."""
    corners = [camera.matrix_world @ corner for corner in camera.data.view_frame(scene=scene)]
    place = camera.matrix_world.translation
    return [corners[i] for i in _EDGES] + [end for corner in corners for end in (place, corner)]
