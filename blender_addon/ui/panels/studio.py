"""Studio: captures with known truth, and what the user's own cameras would reach."""

from __future__ import annotations

import bpy

from ..operators.solver_operator import current
from ..operators.studio import (
    MOCAP_OT_benchmark,
    MOCAP_OT_check_data_set,
    MOCAP_OT_clear_benchmarks,
    MOCAP_OT_make_data_set,
    MOCAP_OT_open_benchmark,
    MOCAP_OT_show_places,
)
from ..settings_layout import draw_setting, settings_layout
from .parts import AcquisitionPanel, draw_failure, draw_next, draw_progress, wrapped

_VERBS = ("studio",)


class VIEW3D_PT_mocap_studio(AcquisitionPanel, bpy.types.Panel):
    """The array and its faults, and how the last run went."""

    bl_idname = "VIEW3D_PT_mocap_studio"
    bl_label = "Studio"
    bl_order = 9
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what data sets and benchmarks share."""
        layout, settings = self.layout, context.scene.mocap.studio
        column = layout.column()
        column.enabled = not current.busy
        settings_layout(column, context)
        draw_setting(column, context, settings, "array")
        if settings.array == "RING":
            for name in ("count", "radius_m", "height_m"):
                draw_setting(column, context, settings, name)
        draw_setting(column, context, settings, "faults")
        draw_setting(column, context, settings, "seed")
        draw_progress(layout, _VERBS)
        draw_failure(layout, context, _VERBS)
        run = current.last
        if not current.busy and run is not None and run.verb in _VERBS and run.error and settings.planned:
            draw_next(layout, context, "Shots that are done stay: Make Data Set goes on where it was.")


class VIEW3D_PT_mocap_benchmark(AcquisitionPanel, bpy.types.Panel):
    """What the array would reach."""

    bl_idname = "VIEW3D_PT_mocap_benchmark"
    bl_parent_id = VIEW3D_PT_mocap_studio.bl_idname
    bl_label = "Benchmark"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the button and the table of arrays."""
        layout, settings = self.layout, context.scene.mocap.studio
        column = layout.column(align=True)
        column.enabled = not current.busy
        column.column(align=True).prop(settings, "methods", expand=True)
        column.prop_menu_enum(settings, "against")
        column.prop(settings, "fewer")
        button = layout.column()
        button.scale_y = 1.6
        button.operator(MOCAP_OT_benchmark.bl_idname, icon="CON_CAMERASOLVER")
        if not len(settings.rows):
            return
        for index, item in enumerate(settings.rows):
            _draw_row(layout.box(), context, index, item)
        low, high = settings.shown_mm
        wrapped(layout, context, f"On the floor: blue {low:.0f} mm, red {high:.0f} mm or more, grey nobody located.")
        layout.operator(MOCAP_OT_clear_benchmarks.bl_idname, icon="X")


class VIEW3D_PT_mocap_data_set(AcquisitionPanel, bpy.types.Panel):
    """Making a data set."""

    bl_idname = "VIEW3D_PT_mocap_data_set"
    bl_parent_id = VIEW3D_PT_mocap_studio.bl_idname
    bl_label = "Data Set"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set

    def draw(self, context: bpy.types.Context) -> None:
        """Draw motion, people, look and pictures, what it would need, and the buttons."""
        layout, settings = self.layout, context.scene.mocap.studio
        column = layout.column()
        column.enabled = not current.busy
        settings_layout(column, context)
        draw_setting(column, context, settings, "motion")
        if settings.motion == "FILE":
            draw_setting(column, context, settings, "motion_path")
        for name in ("frames", "fps", "people", "strange", "look", "film"):
            draw_setting(column, context, settings, name)
        if "rgb" in settings.film:
            draw_setting(column, context, settings, "engine")
        for name in ("scale", "write", "out"):
            draw_setting(column, context, settings, name)
        layout.operator(MOCAP_OT_check_data_set.bl_idname, icon="CHECKMARK")
        if settings.planned:
            wrapped(layout, context, settings.planned, "DISK_DRIVE")
        button = layout.column()
        button.scale_y = 1.4
        button.operator(MOCAP_OT_make_data_set.bl_idname, icon="RENDER_ANIMATION")


def _draw_row(
    layout: bpy.types.UILayout, context: bpy.types.Context, index: int, item: bpy.types.PropertyGroup
) -> None:
    """Draw what an array reached."""
    row = layout.row(align=True)
    row.label(text=item.array, icon="CAMERA_DATA", translate=False)
    row.operator(MOCAP_OT_show_places.bl_idname, text="", icon="MESH_GRID").index = index
    row.operator(MOCAP_OT_open_benchmark.bl_idname, text="", icon="URL").index = index
    faults = item.bl_rna.properties["faults"].enum_items[item.faults].name
    wrapped(layout, context, f"{faults}: {item.reached}")
    floor = "nobody is located on the floor" if item.median_mm < 0 else f"{item.median_mm:.1f} mm over the floor"
    wrapped(layout, context, floor)


CLASSES = (VIEW3D_PT_mocap_studio, VIEW3D_PT_mocap_benchmark, VIEW3D_PT_mocap_data_set)
