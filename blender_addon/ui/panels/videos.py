"""The From Videos panel: the detector, and each step with its results."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import bpy.utils.previews

from ...conventions.file_paths import file_of
from ..layout import draw_lines, draw_next, wrapped
from ..operators.base import current
from ..operators.videos import SET_UP_DETECTOR, draw_video_settings
from ..preferences import detector_text, lacks_detector, uses_included
from ..properties import STEPS, MocapVideoStep
from ..translation import CONTEXT
from .parts import draw_failure, draw_progress, panel

_SIZE = 11.0  # Image height in button heights.


class Previews:
    """Cache of image files shown in panels. An image is loaded again only if its file changes."""

    def __init__(self) -> None:
        self._shown: bpy.utils.previews.ImagePreviewCollection | None = None

    def start(self) -> None:
        """Create an empty cache."""
        self._shown = bpy.utils.previews.new()

    def stop(self) -> None:
        """Remove all images from the cache."""
        if self._shown is not None:
            bpy.utils.previews.remove(self._shown)
        self._shown = None

    @property
    def loaded(self) -> tuple[str, ...]:
        """Paths and modification times of the loaded images."""
        return () if self._shown is None else tuple(self._shown)

    def icon(self, path: Path) -> int:
        """Return the icon number of an image, or 0 if the image cannot be shown."""
        if self._shown is None:
            return 0
        try:
            name = f"{path}|{path.stat().st_mtime_ns}"
        except OSError:
            return 0
        if name not in self._shown:
            for outdated in [key for key in self._shown if key.split("|")[0] == str(path)]:
                del self._shown[outdated]
            self._shown.load(name, str(path), "IMAGE")
        return self._shown[name].icon_id


previews = Previews()


def draw_live_picture(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the latest image from the running detection."""
    run, results = current.run, context.scene.mocap.videos.results
    if run is None or run.verb != "from-videos" or not results:
        return
    began = time.time() - run.elapsed_s
    found = [path for pattern in ("", "*/") for path in file_of(results).glob(f"{pattern}pictures/detect.png")]
    newest = max(found, key=lambda path: path.stat().st_mtime, default=None)
    if newest is not None and newest.stat().st_mtime > began and (value := previews.icon(newest)):
        layout.template_icon(icon_value=value, scale=_SIZE)


@panel("From Videos", "CAPTURE", parent="capture", order=2, closed=True)
def videos(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.mocap.videos
    draw_progress(layout, ("from-videos",))
    _draw_detector(layout, context)
    if not settings.folder:
        draw_next(layout, context, "Drop a video of the take into the viewport, or choose its folder.")
    layout.operator("mocap.capture_from_videos", icon="FILE_MOVIE")
    if settings.folder:
        wrapped(layout, context, settings.folder, "FILE_FOLDER")
    done = {step.name: step for step in settings.steps}
    for name in STEPS if settings.folder else ():
        _draw_step(layout, context, name, done.get(name))
    column = layout.column()
    column.enabled = not current.busy
    draw_video_settings(column, context)


def _draw_detector(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    if draw_progress(layout, (SET_UP_DETECTOR,)):
        return
    draw_failure(layout, context, (SET_UP_DETECTOR,))
    missing = lacks_detector(context)
    wrapped(layout, context, detector_text(context), "ERROR" if missing else "CHECKMARK", alert=missing)
    if uses_included(context):
        return
    operator, icon = ("mocap.set_up_detector", "IMPORT") if missing else ("mocap.test_detector", "PLAY")
    layout.operator(operator, icon=icon)


def _draw_step(layout: bpy.types.UILayout, context: bpy.types.Context, name: str, step: MocapVideoStep | None) -> None:
    box = layout.box()
    row, icon = box.row(align=True), "LAYER_USED"
    if step is not None:
        row.prop(step, "open", text="", icon="DOWNARROW_HLT" if step.open else "RIGHTARROW", emboss=False)
        icon = "ERROR" if step.warnings else "CHECKMARK"
    title = row.row(align=True)
    title.alert = icon == "ERROR"
    title.label(text=STEPS[name][0], text_ctxt=CONTEXT, icon=icon)
    row.operator("mocap.video_step", text="", icon="PLAY" if step is None else "FILE_REFRESH").step = name
    if step is None or not step.open:
        return
    draw_lines(box, context, step.warnings, "ERROR")
    draw_lines(box, context, step.notes)
    for picture in step.pictures:
        value = previews.icon(Path(picture.name))
        if value:
            box.template_icon(icon_value=value, scale=_SIZE)
            box.operator("mocap.open_video_picture", icon="IMAGE_DATA").filepath = picture.name
