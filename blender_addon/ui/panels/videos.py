"""From videos: each step with what it found and its picture, to be done again alone."""

from __future__ import annotations

from pathlib import Path

import bpy
import bpy.utils.previews

from ..operators.base import current
from ..operators.videos import (
    VERB,
    MOCAP_OT_capture_from_videos,
    MOCAP_OT_open_video_picture,
    MOCAP_OT_set_up_detector,
    MOCAP_OT_test_detector,
    MOCAP_OT_video_step,
    draw_settings,
)
from ..preferences import detector_text, lacks_detector
from ..properties import STEPS, MocapVideoStep
from ..translation import CONTEXT
from .parts import StagePanel, draw_failure, draw_next, draw_progress, wrapped


class Previews:
    """The pictures that have been shown, each loaded once and again when its file changes."""

    def __init__(self) -> None:
        self._shown: bpy.utils.previews.ImagePreviewCollection | None = None

    def start(self) -> None:
        """Begin; for registering."""
        self._shown = bpy.utils.previews.new()

    def stop(self) -> None:
        """Let go of all pictures; for unregistering."""
        if self._shown is not None:
            bpy.utils.previews.remove(self._shown)
        self._shown = None

    @property
    def loaded(self) -> tuple[str, ...]:
        """What is loaded now: paths and the times of their files."""
        return () if self._shown is None else tuple(self._shown)

    def icon(self, path: Path) -> int:
        """Return the icon of a picture, 0 where it cannot be shown."""
        if self._shown is None:
            return 0
        try:
            name = f"{path}|{path.stat().st_mtime_ns}"
        except OSError:
            return 0
        if name not in self._shown:
            for former in [key for key in self._shown if key.split("|")[0] == str(path)]:
                del self._shown[former]
            self._shown.load(name, str(path), "IMAGE")
        return self._shown[name].icon_id


previews = Previews()


_VERBS = ("from-videos",)
_SIZE = 11.0
"""Of a picture, in buttons' heights."""


class VIEW3D_PT_mocap_videos(StagePanel, bpy.types.Panel):
    """The way from videos to a capture."""

    stage = "CAPTURE"
    bl_idname = "VIEW3D_PT_mocap_videos"
    bl_parent_id = "VIEW3D_PT_mocap_capture"
    bl_label = "From Videos"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender reads a plain set
    bl_order = 2

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the steps that are done or to be done; while they run, those that are done."""
        layout, videos = self.layout, context.scene.mocap.videos
        draw_progress(layout, _VERBS)
        _draw_detector(layout, context)
        if not videos.folder:
            draw_next(layout, context, "Drop a video of the take on the viewport, or choose its folder.")
        layout.operator(MOCAP_OT_capture_from_videos.bl_idname, icon="FILE_MOVIE")
        if videos.folder:
            wrapped(layout, context, videos.folder, "FILE_FOLDER")
        done = {step.name: step for step in videos.steps}
        for name in STEPS if videos.folder else ():
            _draw_step(layout, context, name, done.get(name))
        column = layout.column()
        column.enabled = not current.busy
        draw_settings(column, context)


def _draw_detector(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw which detector there is or, without one, how to get it."""
    if draw_progress(layout, (VERB,)):
        return
    draw_failure(layout, context, (VERB,))
    missing = lacks_detector(context)
    wrapped(layout, context, detector_text(context), "ERROR" if missing else "CHECKMARK", alert=missing)
    row = layout.row(align=True)
    if missing:
        row.operator(MOCAP_OT_set_up_detector.bl_idname, icon="IMPORT")
    else:
        row.operator(MOCAP_OT_test_detector.bl_idname, text="Test Detector", icon="PLAY")


def _draw_step(layout: bpy.types.UILayout, context: bpy.types.Context, name: str, step: MocapVideoStep | None) -> None:
    """Draw a step's row and, where it is open, what it found."""
    box = layout.box()
    row = box.row(align=True)
    if step is None:
        row.label(text=STEPS[name][0], text_ctxt=CONTEXT, icon="LAYER_USED")
    else:
        row.prop(step, "open", text="", icon="DOWNARROW_HLT" if step.open else "RIGHTARROW", emboss=False)
        row.alert = bool(step.doubts)
        row.label(text=STEPS[name][0], text_ctxt=CONTEXT, icon="ERROR" if step.doubts else "CHECKMARK")
        row.alert = False
    again = row.operator(MOCAP_OT_video_step.bl_idname, text="", icon="PLAY" if step is None else "FILE_REFRESH")
    again.step = name
    if step is None or not step.open:
        return
    for doubt in step.doubts.splitlines():
        wrapped(box, context, doubt, "ERROR", alert=True)
    for word in step.words.splitlines():
        wrapped(box, context, word, "DOT")
    for picture in step.pictures:
        icon = previews.icon(Path(picture.name))
        if icon:
            box.template_icon(icon_value=icon, scale=_SIZE)
            opened = box.operator(MOCAP_OT_open_video_picture.bl_idname, icon="IMAGE_DATA")
            opened.filepath = picture.name
