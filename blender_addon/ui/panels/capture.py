"""Capture: what to read, and what was recognised."""

from __future__ import annotations

import bpy

from ...conventions.kept_findings import findings_in
from ...conventions.naming import counted
from ..layout import draw_setting, is_narrow, settings_layout
from ..operators.base import current
from ..operators.cameras import (
    MOCAP_OT_check_cameras,
    MOCAP_OT_leave_camera,
    MOCAP_OT_leave_out_range,
    MOCAP_OT_refine_cameras,
    MOCAP_OT_restore_cameras,
    MOCAP_OT_show_capture,
    MOCAP_OT_use_range,
    MOCAP_OT_view_camera,
    in_camera_view,
)
from ..operators.import_capture import MOCAP_OT_demo_capture, MOCAP_OT_import_capture
from ..operators.import_motion import MOCAP_OT_import_motion
from ..operators.markers import MOCAP_OT_pick_point, MOCAP_OT_tell_point, MOCAP_OT_untell_point
from ..operators.solve import MOCAP_OT_solve_all
from ..operators.videos import MOCAP_OT_capture_from_videos
from ..preferences import draw_acquisition
from ..properties import MocapCapture, MocapSettings
from ..setting_properties import READING_ROWS
from .parts import TALLEST, StagePanel, draw_finding, draw_next, draw_progress, wrapped

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


_FEW_PERCENT = 60
"""Frames that a view sees the person in, percent, below which its row is red; chosen by hand."""
_CAMERA_VERBS = ("refine-cameras", "check-cameras")


class VIEW3D_PT_mocap_cameras(StagePanel, bpy.types.Panel):
    """The capture's cameras."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_cameras"
    bl_label = "Cameras"
    bl_order = 1

    @classmethod
    def has_subject(cls, settings: bpy.types.PropertyGroup) -> bool:
        """Return whether there are cameras."""
        return bool(settings.capture.cameras)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw one row a camera."""
        layout, scene = self.layout, context.scene
        if scene.mocap.review.armature is None:
            draw_next(layout, context, "Look through the cameras: the points should lie on the person.")
        column, narrow = layout.column(align=True), is_narrow(context)
        for index, item in enumerate(scene.mocap.capture.cameras):
            row = column.row(align=True)
            row.prop(item, "use", text="")
            here = item.object is not None and scene.camera == item.object
            view = row.row(align=True)
            view.alert = item.seen_percent < _FEW_PERCENT
            button = view.operator(
                MOCAP_OT_view_camera.bl_idname, text=f"{item.name} {item.seen_percent:.0f} %", translate=False,
                icon="NONE" if narrow else "FILE_MOVIE" if item.has_footage else "CAMERA_DATA", depress=here,
            )  # fmt: skip
            button.index = index
            row.operator(MOCAP_OT_leave_out_range.bl_idname, text="", icon="TIME", emboss=False).index = index
            if item.detections is not None:
                row.prop(item.detections, "hide_viewport", text="", icon="HIDE_OFF", emboss=False)
        for index, item in enumerate(scene.mocap.capture.left_out):
            row = column.row(align=True)
            row.label(text=item.name, icon="HIDE_ON", translate=False)
            if narrow:
                row.operator(MOCAP_OT_use_range.bl_idname, text="", icon="X", emboss=False).index = index
                row = column.row(align=True)
            row.prop(item, "first", text="")
            row.prop(item, "last", text="")
            if not narrow:
                row.operator(MOCAP_OT_use_range.bl_idname, text="", icon="X", emboss=False).index = index
        layout.prop(scene.mocap.capture, "show_agreement", icon="VIEW_CAMERA")
        _draw_refinement(layout, context)
        if in_camera_view(context):
            layout.operator(MOCAP_OT_leave_camera.bl_idname, icon="LOOP_BACK")


def _draw_refinement(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the calibration's correction, its progress, and what it brought."""
    if draw_progress(layout, _CAMERA_VERBS):
        return
    capture = context.scene.mocap.capture
    layout.operator(MOCAP_OT_check_cameras.bl_idname, icon="CHECKMARK")
    for found in findings_in(capture.doubts):
        draw_finding(layout, context, found)
    for word in capture.checked.splitlines():
        wrapped(layout, context, word, "DOT")
    row = layout.row(align=True)
    row.operator(MOCAP_OT_refine_cameras.bl_idname, icon="CON_CAMERASOLVER")
    if capture.original:
        row.operator(MOCAP_OT_restore_cameras.bl_idname, text="", icon="LOOP_BACK")
        wrapped(layout, context, f"Refined: {capture.refined_text()}.", "CHECKMARK")
