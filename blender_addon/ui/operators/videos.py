"""A capture from videos: by button, by menu, by dropping a video on the viewport; each step again, alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy_extras.io_utils import ImportHelper

from ..._exchange.errors import OutputNotWritable, sentence
from ...conventions.file_paths import absolute, file_of, stored
from ...errors import TakeMissing
from ..locations import RELATIVE, files_folder, usable
from ..preferences import detector_for, litert_python
from ..settings_layout import draw_setting, settings_layout
from ..video_properties import STEPS
from .base import MocapOperator, ViewportDrop
from .solver_operator import SolverOperator, current

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, TakeOfVideos, VideosResult

SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts")
"""Of the videos that cameras write."""
_LAST = list(STEPS)[-1]


class VideosOperator(SolverOperator):
    """Mixin of operators that go the road from videos; what is done is shown while the rest is under way."""

    is_of_capture = False
    _seen = 0

    def go(self, context: bpy.types.Context, until: str, redo: str = "") -> set[str]:
        """Start on the scene's folder of videos.

        Raises:
            MocapError: results cannot be written, or the solver cannot be started.
        """
        videos = context.scene.mocap.videos
        folder, results = file_of(videos.folder), file_of(videos.results)
        arguments = [str(folder), "--out", str(usable(results)), "--until", until, *videos.arguments()]
        python = detector_for(context)
        arguments += ["--python", str(python)] if python is not None else []
        hands = litert_python(context) if videos.hands else None
        arguments += ["--hand-python", str(hands)] if hands is not None else []
        arguments += ["--redo", redo] if redo else []
        return self.launch(context, "from-videos", arguments, results)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show steps as soon as they are done."""
        if event.type == "TIMER" and current.run is not None:
            self._show_steps(context)
        return super().modal(context, event)

    def received(self, context: bpy.types.Context, result: VideosResult) -> set[str]:
        """Set the stage of each take that was put together."""
        takes = list(result["takes"].values())
        self._show_steps(context, takes)
        read = [(take["read"], Path(take["source"])) for take in takes]
        names = [self._staged(context, capture, source) for capture, source in read if capture is not None]
        failed = [f"{name}: {sentence(error)}" for name, error in result.get("failed", {}).items()]
        found = f"Captures from videos: {', '.join(names)}" if names else "The step is finished; see the panel"
        self.report({"WARNING"} if failed else {"INFO"}, ". ".join([found, *failed]))
        return {"FINISHED"}

    def rescue(self, context: bpy.types.Context) -> str:
        """Show the steps that were done before one failed."""
        self._show_steps(context)
        done = [STEPS[step.name][0].lower() for step in context.scene.mocap.videos.steps]
        return f"Done before that: {', '.join(done)}." if done else ""

    def _show_steps(self, context: bpy.types.Context, takes: list[TakeOfVideos] | None = None) -> None:
        """Read what the steps reported, if they reported anything new; of several takes those of the last one."""
        videos = context.scene.mocap.videos
        folders = [Path(take["folder"]) for take in takes or ()] or _with_reports(file_of(videos.results))
        if not folders:
            return
        road = max(folders, key=_changed)
        if takes is not None or _changed(road) != self._seen:
            self._seen = _changed(road)
            videos.take_steps(str(road))

    def _staged(self, context: bpy.types.Context, read: CaptureResult, source: Path) -> str:
        from .import_results import present_capture, take_capture

        settings = context.scene.mocap
        for capture in settings.captures:
            if capture.source and file_of(capture.source) == source:
                capture.file = stored(read["capture"])  # it may have followed the .blend file
        stage = take_capture(context.scene, read, source)
        settings.capture.source = stored(source)
        present_capture(context, stage)
        return settings.capture.name


class MOCAP_OT_capture_from_videos(VideosOperator, bpy.types.Operator, ImportHelper):
    """Finds keypoints, clocks and cameras of videos, and sets up the capture."""

    bl_idname = "mocap.capture_from_videos"
    bl_label = "Capture from Videos"
    bl_description = (
        "Choose the folder of a take, one video a camera. Keypoints are detected, cameras synchronised and, if needed, "
        "calibrated; the capture is then ready to solve. Finished steps are kept"
    )

    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"} | RELATIVE)
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    one_camera: bpy.props.BoolProperty(
        name="This Video Alone",
        description="One camera filmed the take; the other videos of the folder are not of it",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask board or person of what was dropped, or let the user choose a folder."""
        if self.files or (self.filepath and absolute(self.filepath).exists()):
            return context.window_manager.invoke_props_dialog(self, width=380)
        return ImportHelper.invoke(self, context, event)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what the user may set, beside the folders."""
        self.layout.prop(self, "one_camera")
        draw_settings(self.layout, context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Begin with the folder of what was chosen, or with the video alone.

        Raises:
            TakeMissing: one video is asked for, and none is chosen.
            MocapError: see ``VideosOperator.go``.
        """
        chosen = absolute(self.filepath or self.directory)
        if self.files and self.files[0].name and self.directory:
            chosen = absolute(self.directory) / self.files[0].name
        if self.one_camera and not chosen.is_file():
            raise TakeMissing("No video is chosen.", where=str(chosen), hint="Choose the video file, not its folder.")
        folder = chosen if chosen.is_dir() else absolute(self.directory) if self.directory else chosen.parent
        videos = context.scene.mocap.videos
        results = _results(context, folder, f"{chosen.stem}_mocap" if self.one_camera else "mocap")
        videos.folder, videos.results = stored(chosen if self.one_camera else folder), stored(results)
        videos.steps.clear()
        return self.go(context, _LAST)


class MOCAP_OT_video_step(VideosOperator, bpy.types.Operator):
    """Does one step from videos, again where it was done."""

    bl_idname = "mocap.video_step"
    bl_label = "Run This Step"
    bl_description = "Run this step with the current settings, again if it was done, and the steps that follow"

    step: bpy.props.EnumProperty(
        name="Step", items=[(name, *texts) for name, texts in STEPS.items()], options={"SKIP_SAVE"}
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs videos."""
        if not context.scene.mocap.videos.folder:
            cls.poll_message_set("Choose a folder of videos first")
            return False
        return super().poll(context)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start; a capture that was put together is put together anew."""
        done = {step.name for step in context.scene.mocap.videos.steps}
        return self.go(context, _LAST if _LAST in done else self.step, self.step if self.step in done else "")


class MOCAP_OT_open_video_picture(MocapOperator, bpy.types.Operator):
    """Opens a step's picture in the system's viewer."""

    bl_idname = "mocap.open_video_picture"
    bl_label = "Open Picture"
    bl_description = "Open this picture in full size in the system's own viewer"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    filepath: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Hand it to the system; only a picture that a step of this scene drew."""
        drawn = {picture.name for step in context.scene.mocap.videos.steps for picture in step.pictures}
        if self.filepath not in drawn or not Path(self.filepath).is_file():
            raise TakeMissing("The picture no longer exists.", where=self.filepath, hint="Run the step again.")
        return bpy.ops.wm.path_open(filepath=self.filepath)


class MOCAP_FH_videos(ViewportDrop, bpy.types.FileHandler):
    """Takes videos that are dropped on the 3D viewport; one of them stands for its folder."""

    bl_idname = "MOCAP_FH_videos"
    bl_label = "Capture from videos"
    bl_import_operator = "mocap.capture_from_videos"
    bl_file_extensions = ";".join(SUFFIXES)


def draw_settings(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw what the user may set for videos: cameras, person, clocks, detector."""
    videos = context.scene.mocap.videos
    settings_layout(layout, context)
    draw_setting(layout, context, videos, "cameras")
    if videos.cameras != "person":
        draw_setting(layout, context, videos, "board")
    if videos.cameras != "board":
        draw_setting(layout, context, videos, "stature")
    draw_setting(layout, context, videos, "lenses")
    if not videos.lenses:
        draw_setting(layout, context, videos, "focal")
    draw_setting(layout, context, videos, "sync")
    draw_setting(layout, context, videos, "detector")
    if videos.detector == "model":
        draw_setting(layout, context, videos, "model")
    draw_setting(layout, context, videos, "hands")
    draw_setting(layout, context, videos, "people")


def _results(context: bpy.types.Context, folder: Path, name: str) -> Path:
    """Return where results of videos go: beside them, or to the folder of captures where that cannot be written to.

    Raises:
        OutputNotWritable: neither can.
    """
    from ...solving.take_paths import capture_folder

    try:
        return usable(folder / name)
    except OutputNotWritable:
        return usable(capture_folder(files_folder(context.scene), folder))


def _with_reports(results: Path) -> list[Path]:
    """Return the folders of takes below the results whose steps have reported something."""
    from ...solving.road_file import NAME

    return [path.parent for path in (*results.glob(NAME), *results.glob(f"*/{NAME}"))]


def _changed(folder: Path) -> int:
    """Return when the steps of a take last reported something, 0 where they never did."""
    from ...solving.road_file import NAME

    try:
        return (folder / NAME).stat().st_mtime_ns
    except OSError:
        return 0


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry in File > Import."""
    self.layout.operator(MOCAP_OT_capture_from_videos.bl_idname, text="Motion Capture from Videos (folder)")


CLASSES = (MOCAP_OT_capture_from_videos, MOCAP_OT_video_step, MOCAP_OT_open_video_picture, MOCAP_FH_videos)
