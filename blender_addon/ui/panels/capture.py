"""Capture: what to read, and what was recognised."""

from __future__ import annotations

import bpy

from ...conventions.naming import counted
from ..operators.import_capture import MOCAP_OT_demo_capture, MOCAP_OT_import_capture
from ..operators.import_motion import MOCAP_OT_import_motion
from ..operators.solver_operator import current
from ..operators.videos import MOCAP_OT_capture_from_videos
from ..operators.views import MOCAP_OT_show_capture
from ..preferences import draw_acquisition
from ..properties import MocapCapture, MocapSettings
from ..setting_properties import READING_ROWS
from ..settings_layout import draw_setting, settings_layout
from .findings import draw_finding
from .parts import TALLEST, StagePanel, draw_next, draw_progress, wrapped

_VERBS = ("convert", "demo-capture")


class VIEW3D_PT_mocap_capture(StagePanel, bpy.types.Panel):
    """Reading a capture."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_capture"
    bl_label = "Capture"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the button, progress, and what was recognised."""
        layout, capture = self.layout, context.scene.mocap.capture
        if draw_progress(layout, _VERBS):
            return
        if not capture.file:
            draw_next(layout, context, "Drop any file of your capture on the viewport, or choose its folder.")
        button = layout.column()
        button.scale_y = 1.0 if capture.file else TALLEST
        button.operator(MOCAP_OT_import_capture.bl_idname, icon="IMPORT")
        column = layout.column(align=True)
        column.operator(MOCAP_OT_capture_from_videos.bl_idname, icon="FILE_MOVIE")
        column.operator(MOCAP_OT_import_motion.bl_idname, icon="ARMATURE_DATA")
        if len(context.scene.mocap.captures) > 1:
            _draw_captures(layout, context.scene.mocap)
        if capture.file:
            _draw_recognised(layout, context, capture)
        else:
            column = layout.column(align=True)
            column.operator(MOCAP_OT_demo_capture.bl_idname, icon="ARMATURE_DATA").kind = "CAMERAS"
            column.operator(MOCAP_OT_demo_capture.bl_idname, text="With Markers").kind = "MARKERS"


class VIEW3D_PT_mocap_reading(StagePanel, bpy.types.Panel):
    """How the next capture is read."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_reading"
    bl_parent_id = "VIEW3D_PT_mocap_capture"
    bl_label = "Reading Options"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options, and reading the same source again."""
        layout, settings = self.layout, context.scene.mocap
        settings_layout(layout, context)
        layout.enabled = not current.busy
        for name in (
            "scene_setup",
            "joint_set",
            "unit",
            "up_axis",
            *READING_ROWS,
            "footage_anywhere",
        ):
            draw_setting(layout, context, settings.reading, name)
        if settings.capture.source:
            again = layout.operator(MOCAP_OT_import_capture.bl_idname, text="Read Again", icon="FILE_REFRESH")
            again.filepath = settings.capture.source
        draw_acquisition(layout, context)


class VIEW3D_PT_mocap_problems(StagePanel, bpy.types.Panel):
    """What is wrong with the capture."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_problems"
    bl_parent_id = "VIEW3D_PT_mocap_capture"
    bl_label = "Problems"
    bl_order = 0

    @classmethod
    def has_subject(cls, settings: MocapSettings) -> bool:
        """Return whether there are problems."""
        return any(message.is_problem for message in settings.capture.messages)

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the warning."""
        self.layout.alert = True
        self.layout.label(icon="ERROR")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the problems, each with the button that remedies it."""
        for message in context.scene.mocap.capture.messages:
            for found in message.found if message.is_problem else ():
                draw_finding(self.layout, context, found)


class VIEW3D_PT_mocap_notes(StagePanel, bpy.types.Panel):
    """What the reader assumed; what it assumed about markers is in their own panel."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_notes"
    bl_parent_id = "VIEW3D_PT_mocap_capture"
    bl_label = "Notes"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 1

    @classmethod
    def has_subject(cls, settings: MocapSettings) -> bool:
        """Return whether there is a capture that is not of markers."""
        return bool(settings.capture.file) and not settings.capture.marker_items

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the notes."""
        for message in context.scene.mocap.capture.messages:
            if not message.is_problem:
                wrapped(self.layout, context, message.text, "DOT")


def _draw_captures(layout: bpy.types.UILayout, settings: MocapSettings) -> None:
    """Draw a button for each capture of the scene."""
    column, shown = layout.column(align=True), settings.capture_index
    for index, capture in enumerate(settings.captures):
        button = column.operator(
            MOCAP_OT_show_capture.bl_idname, text=capture.name, depress=index == shown, translate=False,
            icon="RADIOBUT_ON" if index == shown else "RADIOBUT_OFF",
        )  # fmt: skip
        button.index = index


def _draw_recognised(layout: bpy.types.UILayout, context: bpy.types.Context, capture: MocapCapture) -> None:
    box = layout.box()
    column = box.column(align=True)
    column.label(text=capture.name, icon="CHECKMARK", translate=False)
    seconds = capture.frames / capture.fps if capture.fps else 0.0
    wrapped(column, context, f"{counted(capture.frames, 'frame')}, {seconds:.1f} s at {capture.fps:g} fps", "TIME")
    parts = [counted(len(capture.cameras), "camera")] if capture.cameras else []
    parts += [capture.joint_set] if capture.joint_set else []
    parts += [counted(capture.markers, "marker")] if capture.markers else []
    wrapped(column, context, ", ".join(parts), "CAMERA_DATA" if capture.cameras else "EMPTY_DATA")
