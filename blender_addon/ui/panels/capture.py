"""Panels of the Capture stage: import, problems, notes, markers, people, reading options and cameras."""

from __future__ import annotations

from typing import Any

import bpy

from ...conventions.kept_findings import findings_in
from ...conventions.naming import counted
from ..layout import TALLEST, draw_button, draw_lines, draw_next, draw_settings, is_narrow, wrapped
from ..operators.base import CAPTURE, MARKERS, current
from ..operators.capture import in_camera_view
from ..preferences import draw_acquisition
from ..properties import MocapCapture, MocapSettings
from ..setting_properties import READING_ROWS
from .parts import draw_finding, draw_progress, panel

MEANINGS = {
    "known": "CHECKMARK",
    "unknown": "QUESTION",
    "computed": "EMPTY_AXIS",
    "doubled": "DUPLICATE",
    "unlabelled": "DOT",
}
"""Icon of each kind of marker label."""
_FEW_PERCENT = 60  # Cameras that see the person in a smaller percentage of frames are red. Chosen by hand.


@panel("Capture", "CAPTURE")
def capture(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap
    if draw_progress(layout, ("convert", "dataset demo")):
        return
    if not settings.capture.file:
        draw_next(layout, context, "Drop any file from your capture into the viewport, or choose its folder.")
    draw_button(layout, "mocap.import_capture", "IMPORT", 1.0 if settings.capture.file else TALLEST)
    column = layout.column(align=True)
    column.operator("mocap.capture_from_videos", icon="FILE_MOVIE")
    column.operator("mocap.import_motion", icon="ARMATURE_DATA")
    if len(settings.captures) > 1:
        _draw_captures(layout, settings)
    if settings.capture.file:
        _draw_recognised(layout, context, settings.capture)
    else:
        column = layout.column(align=True)
        column.operator("mocap.demo_capture", icon="ARMATURE_DATA").kind = "CAMERAS"
        column.operator("mocap.demo_capture", text="With Markers").kind = "MARKERS"


def _draw_captures(layout: bpy.types.UILayout, settings: MocapSettings) -> None:
    column, shown = layout.column(align=True), settings.capture_index
    for index, item in enumerate(settings.captures):
        icon = "RADIOBUT_ON" if index == shown else "RADIOBUT_OFF"
        shows = {"text": item.name, "depress": index == shown, "translate": False, "icon": icon}
        column.operator("mocap.show_capture", **shows).index = index


def _draw_recognised(layout: bpy.types.UILayout, context: bpy.types.Context, item: MocapCapture) -> None:
    box = layout.box()
    column = box.column(align=True)
    column.label(text=item.name, icon="CHECKMARK", translate=False)
    seconds = item.frames / item.fps if item.fps else 0.0
    wrapped(column, context, f"{counted(item.frames, 'frame')}, {seconds:.1f} s at {item.fps:g} fps", "TIME")
    parts = [counted(len(item.cameras), "camera")] if len(item.cameras) else []
    parts += [item.joint_set] if item.joint_set else []
    parts += [counted(item.markers, "marker")] if item.markers else []
    wrapped(column, context, ", ".join(parts), "CAMERA_DATA" if len(item.cameras) else "EMPTY_DATA")


@panel("Reading Options", "CAPTURE", parent="capture", order=3, closed=True)
def reading(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap
    layout.enabled = not current.busy
    names = ("scene_setup", "joint_set", "unit", "up_axis", *READING_ROWS, "footage_anywhere")
    draw_settings(layout, context, settings.reading, *names)
    if settings.capture.source:
        again = layout.operator("mocap.import_capture", text="Read Again", icon="FILE_REFRESH")
        again.filepath = settings.capture.source
    draw_acquisition(layout, context)


def _draw_problem_icon(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    layout.alert = True
    layout.label(icon="ERROR")


def _has_problems(context: bpy.types.Context) -> bool:
    return bool(context.scene.mocap.capture.problems)


@panel("Problems", "CAPTURE", parent="capture", needs=_has_problems, draw_header=_draw_problem_icon)
def problems(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    for found in context.scene.mocap.capture.problems:
        draw_finding(layout, context, found)


def _has_notes(context: bpy.types.Context) -> bool:
    return CAPTURE.is_met(context) and not MARKERS.is_met(context)


@panel("Notes", "CAPTURE", parent="capture", order=1, closed=True, needs=_has_notes)
def notes(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    for found in context.scene.mocap.capture.notes:
        draw_finding(layout, context, found)


class MOCAP_UL_markers(bpy.types.UIList):
    """List of the capture's markers with their gaps."""

    def draw_item(
        self, context: Any, layout: bpy.types.UILayout, data: Any, item: Any, icon: int, owner: Any, active: str
    ) -> None:
        row = layout.row()
        row.label(text=item.name.rpartition(":")[2], icon=MEANINGS[item.meaning], translate=False)
        gaps = row.row()
        gaps.alignment = "RIGHT"
        if item.gaps:
            gaps.label(text=f"{counted(item.gaps, 'gap')}, {item.missing_percent:.1f} %", translate=False)


@panel("Markers", "CAPTURE", parent="capture", order=1, needs=MARKERS.is_met)
def markers(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    item = context.scene.mocap.capture
    for line in summarise(item):
        wrapped(layout, context, line)
    for found in item.notes:
        draw_finding(layout, context, found)
    row = layout.row(align=True)
    row.prop(item, "show_names", icon="FONT_DATA")
    colours = row.row(align=True)
    colours.enabled = context.scene.mocap.review.take is not None
    colours.prop(item, "show_residuals", icon="COLOR")


def summarise(capture: MocapCapture) -> list[str]:
    """Return text lines about a capture's markers: the number with each meaning, the subjects, and the gaps."""
    items = list(capture.marker_items)
    counts = {kind: sum(item.meaning == kind for item in items) for kind in MEANINGS}
    lines = [", ".join(f"{count} {kind}" for kind, count in counts.items() if count)]
    if capture.subjects:
        lines.append(f"Subjects: {capture.subjects}")
    gaps = [item for item in items if item.gaps]
    if gaps:
        worst = max(gaps, key=lambda item: item.missing_percent)
        label = worst.name.rpartition(":")[2]
        count = counted(sum(item.gaps for item in gaps), "gap")
        most = f"{label} is missing most often, in {worst.missing_percent:.0f} % of the frames"
        lines.append(f"{count} in {counted(len(gaps), 'marker')}. {most}")
    return lines


@panel("Labels", "CAPTURE", parent="capture", order=2, closed=True, needs=MARKERS.is_met)
def labels(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    item = context.scene.mocap.capture
    lists = (MOCAP_UL_markers.__name__, "", item, "marker_items", item, "marker_index")
    layout.template_list(*lists, rows=6, maxrows=12)
    if 0 <= item.marker_index < len(item.marker_items):
        layout.prop(item.marker_items[item.marker_index], "bone")
    column = layout.column(align=True)
    row = column.row(align=True)
    row.operator("mocap.pick_point", icon="EYEDROPPER")
    row.prop(item, "label_name", text="")
    row.operator("mocap.label_point", text="", icon="CHECKMARK")
    for index, label in enumerate(item.point_labels):
        line = column.row(align=True)
        text = f"{label.name} from frame {label.frame + item.frame_start}: {label.marker or 'no marker'}"
        line.label(text=text, icon="DOT", translate=False)
        line.operator("mocap.remove_point_label", text="", icon="X").index = index


class MOCAP_UL_people(bpy.types.UIList):
    """List of the capture's people with the mean number of cameras that see them."""

    def draw_item(
        self,
        context: Any,
        layout: bpy.types.UILayout,
        data: Any,
        item: Any,
        icon: int,
        owner: Any,
        active: str,
        index: int = 0,
        flt_flag: int = 0,
    ) -> None:
        solved = data.review_of(index).take is not None
        row = layout.split(factor=0.6, align=True)
        row.prop(item, "name", text="", emboss=False, icon="OUTLINER_OB_ARMATURE" if solved else "USER")
        row.label(text=f"{item.views:.1f}", icon="CAMERA_DATA", translate=False)


def _has_people(context: bpy.types.Context) -> bool:
    return bool(len(context.scene.mocap.capture.people))


@panel("People", "CAPTURE", parent="capture", order=2, needs=_has_people)
def people(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    item = context.scene.mocap.capture
    rows = min(6, max(2, len(item.people)))
    layout.template_list(MOCAP_UL_people.__name__, "", item, "people", item, "person_shown", rows=rows)
    person = item.person
    if person is not None and item.person_index != item.person_shown:
        layout.label(text=f"Active body: {person.name}", icon="INFO", translate=False)


@panel("Cameras", "CAPTURE", order=1, needs=lambda context: len(context.scene.mocap.capture.cameras))
def cameras(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    scene, narrow = context.scene, is_narrow(context)
    if scene.mocap.review.armature is None:
        draw_next(layout, context, "Look through the cameras and check that the points are on the person.")
    column = layout.column(align=True)
    for index, item in enumerate(scene.mocap.capture.cameras):
        row = column.row(align=True)
        row.prop(item, "use", text="")
        view = row.row(align=True)
        view.alert = item.seen_percent < _FEW_PERCENT
        text, here = f"{item.name} {item.seen_percent:.0f} %", item.object is not None and scene.camera == item.object
        icon = "NONE" if narrow else "FILE_MOVIE" if item.has_footage else "CAMERA_DATA"
        shows = {"text": text, "translate": False, "icon": icon, "depress": here}
        view.operator("mocap.view_camera", **shows).index = index
        row.operator("mocap.leave_out_range", text="", icon="TIME", emboss=False).index = index
        if item.detections is not None:
            row.prop(item.detections, "hide_viewport", text="", icon="HIDE_OFF", emboss=False)
    for index, item in enumerate(scene.mocap.capture.left_out):
        row = first = column.row(align=True)
        row.label(text=item.name, icon="HIDE_ON", translate=False)
        row = column.row(align=True) if narrow else row
        row.prop(item, "first", text="")
        row.prop(item, "last", text="")
        first.operator("mocap.use_range", text="", icon="X", emboss=False).index = index
    layout.prop(scene.mocap.capture, "show_agreement", icon="VIEW_CAMERA")
    _draw_calibration(layout, context)
    if in_camera_view(context):
        layout.operator("mocap.leave_camera", icon="LOOP_BACK")


def _draw_calibration(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    if draw_progress(layout, ("cameras refine", "cameras check")):
        return
    item = context.scene.mocap.capture
    layout.operator("mocap.check_cameras", icon="CHECKMARK")
    for found in findings_in(item.check_findings):
        draw_finding(layout, context, found)
    draw_lines(layout, context, item.checked)
    row = layout.row(align=True)
    row.operator("mocap.refine_cameras", icon="CON_CAMERASOLVER")
    if item.original:
        row.operator("mocap.restore_cameras", text="", icon="LOOP_BACK")
        wrapped(layout, context, f"Refined: {item.refined_text()}.", "CHECKMARK")
