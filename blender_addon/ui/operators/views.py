"""Looking through the capture's cameras, and away from them."""

from __future__ import annotations

import bpy

from ..._exchange.errors import CaptureInvalid
from .base import MocapOperator


class MOCAP_OT_view_camera(MocapOperator, bpy.types.Operator):
    """Looks through one of the capture's cameras."""

    bl_idname = "mocap.view_camera"
    bl_label = "Look Through Camera"
    bl_description = "Look through this camera, with the body over its footage"

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Make it the scene's camera, show its detections alone, and turn the viewport to it."""
        from ...scene.cameras import look_through

        cameras = context.scene.mocap.capture.cameras
        chosen = cameras[self.index].object if self.index < len(cameras) else None
        if chosen is None:
            raise CaptureInvalid("This camera was deleted.", hint="Import the capture again.")
        look_through(context.scene, chosen)
        _show_detections(context.scene, chosen)
        if _in_viewport(context):
            context.space_data.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}


class MOCAP_OT_leave_camera(MocapOperator, bpy.types.Operator):
    """Leaves the camera's view."""

    bl_idname = "mocap.leave_camera"
    bl_label = "Leave Camera"
    bl_description = "Look at the scene freely again, with the detections of all cameras and the whole floor"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only in a camera's view."""
        return in_camera_view(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Turn to perspective."""
        _show_detections(context.scene, None)
        context.space_data.region_3d.view_perspective = "PERSP"
        return {"FINISHED"}


class MOCAP_OT_show_capture(MocapOperator, bpy.types.Operator):
    """Turns the panels to another capture."""

    bl_idname = "mocap.show_capture"
    bl_label = "Show Capture"
    bl_description = "Show this capture in the panels; making one of its objects active does the same"

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Turn to it."""
        context.scene.mocap.show(self.index)
        return {"FINISHED"}


def in_camera_view(context: bpy.types.Context) -> bool:
    """Return whether the viewport looks through a camera."""
    return _in_viewport(context) and context.space_data.region_3d.view_perspective == "CAMERA"


def _in_viewport(context: bpy.types.Context) -> bool:
    return context.space_data is not None and context.space_data.type == "VIEW_3D"


def _show_detections(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> None:
    """Show the detections of one camera, or of all; before footage the floor is lines alone."""
    capture = scene.mocap.capture
    for item in capture.cameras:
        if item.detections is not None:
            item.detections.hide_viewport = camera is not None and item.object != camera
    if capture.floor is not None:
        capture.floor.display_type = "TEXTURED" if camera is None else "WIRE"


CLASSES = (MOCAP_OT_view_camera, MOCAP_OT_leave_camera, MOCAP_OT_show_capture)
