"""One table of everything the add-on registers; unregistering walks it backwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import bpy

from ..headless.blender_command import command
from . import (
    adoption,
    bone_colours,
    camera_view,
    confidence_view,
    live_run,
    marker_view,
    preferences,
    project_files,
    properties,
    retarget_properties,
    studio_properties,
)
from .operators import (
    add_gloves,
    calibrate_subject,
    cameras,
    clean_up,
    detector,
    export_markers,
    export_take,
    fixes,
    import_capture,
    import_motion,
    limbs,
    live,
    motion_from_rig,
    retarget,
    review,
    rig,
    send_take,
    solve,
    solve_all,
    solver_operator,
    studio,
    takes,
    tell_points,
    videos,
    views,
)
from .panels import cameras as cameras_panel
from .panels import capture as capture_panels
from .panels import export as export_panel
from .panels import fingers as fingers_panel
from .panels import frame_rate as frame_rate_notice
from .panels import limbs as limbs_panel
from .panels import live as live_panel
from .panels import markers as marker_panel
from .panels import people as people_panel
from .panels import result as result_panel
from .panels import retarget as retarget_panels
from .panels import review as review_panels
from .panels import rig as rig_panel
from .panels import run as run_panel
from .panels import shape as shape_panel
from .panels import solve as solve_panels
from .panels import studio as studio_panels
from .panels import videos as videos_panel
from .previews import previews
from .translation import add_translations, in_our_context, remove_translations


@dataclass(frozen=True)
class Registrable:
    """One thing to register, and how to take it back."""

    add: Callable[[], None]
    remove: Callable[[], None]


def _class(cls: type) -> Registrable:
    return Registrable(lambda: bpy.utils.register_class(in_our_context(cls)), lambda: bpy.utils.unregister_class(cls))


def _draw(owner: type, draw: Callable[..., None]) -> Registrable:
    return Registrable(lambda: owner.append(draw), lambda: owner.remove(draw))


def _handler(handlers: list[Callable[..., None]], function: Callable[..., None]) -> Registrable:
    return Registrable(lambda: handlers.append(function), lambda: handlers.remove(function))


def _pointer(owner: type, name: str, cls: type) -> Registrable:
    return Registrable(lambda: setattr(owner, name, bpy.props.PointerProperty(type=cls)), lambda: delattr(owner, name))


TABLE: tuple[Registrable, ...] = (
    Registrable(add_translations, remove_translations),
    *map(_class, retarget_properties.CLASSES),
    *map(_class, studio_properties.CLASSES),
    *map(_class, properties.CLASSES),
    _pointer(bpy.types.Scene, "mocap", properties.MocapSettings),
    _class(preferences.MOCAP_OT_test_python),
    _class(preferences.MocapPreferences),
    Registrable(lambda: None, solver_operator.current.abandon),
    _class(solver_operator.MOCAP_OT_cancel),
    _class(solver_operator.MOCAP_OT_dismiss),
    _class(import_motion.MOCAP_OT_import_motion),
    _class(motion_from_rig.MOCAP_OT_motion_from_rig),
    _class(add_gloves.MOCAP_OT_add_gloves),
    _class(import_capture.MOCAP_OT_import_capture),
    _class(import_capture.MOCAP_OT_demo_capture),
    _class(import_capture.MOCAP_FH_capture),
    _class(calibrate_subject.MOCAP_OT_calibrate_subject),
    _class(solve.MOCAP_OT_solve),
    _class(solve_all.MOCAP_OT_solve_all),
    _class(solve.MOCAP_OT_resolve_range),
    _class(solve.MOCAP_OT_show_log),
    *map(_class, review.CLASSES),
    *map(_class, takes.CLASSES),
    *map(_class, views.CLASSES),
    *map(_class, cameras.CLASSES),
    *map(_class, videos.CLASSES),
    *map(_class, detector.CLASSES),
    *map(_class, clean_up.CLASSES),
    *map(_class, fixes.CLASSES),
    *map(_class, limbs.CLASSES),
    *map(_class, retarget.CLASSES),
    Registrable(lambda: None, live_run.live.abandon),
    *map(_class, live.CLASSES),
    *map(_class, rig.CLASSES),
    Registrable(lambda: None, send_take.playing.stop),
    *map(_class, send_take.CLASSES),
    *map(_class, tell_points.CLASSES),
    *map(_class, studio.CLASSES),
    _class(export_take.MOCAP_OT_export_take),
    _class(export_markers.MOCAP_OT_export_markers),
    _class(run_panel.VIEW3D_PT_mocap_run),
    _class(run_panel.VIEW3D_PT_mocap_acquisition_run),
    _class(capture_panels.VIEW3D_PT_mocap_capture),
    _class(capture_panels.VIEW3D_PT_mocap_problems),
    _class(marker_panel.MOCAP_UL_markers),
    _class(marker_panel.VIEW3D_PT_mocap_markers),
    _class(marker_panel.VIEW3D_PT_mocap_labels),
    _class(capture_panels.VIEW3D_PT_mocap_notes),
    _class(capture_panels.VIEW3D_PT_mocap_reading),
    Registrable(previews.start, previews.stop),
    *map(_class, videos_panel.CLASSES),
    *map(_class, people_panel.CLASSES),
    _class(cameras_panel.VIEW3D_PT_mocap_cameras),
    _class(solve_panels.VIEW3D_PT_mocap_solve),
    _class(solve_panels.VIEW3D_PT_mocap_solve_settings),
    *map(_class, result_panel.CLASSES),
    _class(review_panels.VIEW3D_PT_mocap_review),
    _class(review_panels.VIEW3D_PT_mocap_resolve),
    _class(review_panels.VIEW3D_PT_mocap_clean_up),
    _class(review_panels.VIEW3D_PT_mocap_take),
    _class(shape_panel.VIEW3D_PT_mocap_shape),
    _class(limbs_panel.VIEW3D_PT_mocap_limbs),
    _class(fingers_panel.VIEW3D_PT_mocap_fingers),
    *map(_class, export_panel.CLASSES),
    *map(_class, retarget_panels.CLASSES),
    _class(live_panel.VIEW3D_PT_mocap_live),
    *map(_class, rig_panel.CLASSES),
    _handler(bpy.app.handlers.load_pre, live_run.before_load),
    _handler(bpy.app.handlers.load_pre, send_take.before_load),
    _handler(bpy.app.handlers.frame_change_post, send_take.on_frame_change),
    *map(_class, studio_panels.CLASSES),
    _handler(bpy.app.handlers.frame_change_pre, bone_colours.on_frame_change),
    Registrable(marker_view.drawing.start, marker_view.drawing.stop),
    Registrable(camera_view.drawing.start, camera_view.drawing.stop),
    Registrable(confidence_view.drawing.start, confidence_view.drawing.stop),
    _handler(bpy.app.handlers.load_post, solver_operator.after_load),
    _handler(bpy.app.handlers.load_post, adoption.on_load),
    _handler(bpy.app.handlers.depsgraph_update_post, adoption.on_update),
    _handler(bpy.app.handlers.save_pre, project_files.before_save),
    _handler(bpy.app.handlers.save_post, project_files.after_save),
    _handler(bpy.app.handlers.save_post_fail, project_files.after_failed_save),
    _draw(bpy.types.TOPBAR_MT_file_import, import_capture.draw_import_menu),
    _draw(bpy.types.TOPBAR_MT_file_import, videos.draw_import_menu),
    _draw(bpy.types.TOPBAR_MT_file_import, import_motion.draw_import_menu),
    _draw(bpy.types.TOPBAR_MT_file_export, export_take.draw_export_menu),
    _draw(bpy.types.TOPBAR_MT_file_export, export_markers.draw_export_menu),
    *(_draw(getattr(bpy.types, name), frame_rate_notice.draw_rate_button) for name in frame_rate_notice.HEADERS),
    Registrable(command.register, command.unregister),
)
"""In the order of registration."""


def register() -> None:
    """Register the table from top to bottom."""
    for entry in TABLE:
        entry.add()


def unregister() -> None:
    """Take back the table from bottom to top."""
    for entry in reversed(TABLE):
        entry.remove()
