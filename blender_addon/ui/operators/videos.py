"""Operators that make captures from videos, and that set up and test the person detector."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy_extras.io_utils import ImportHelper

from ..._exchange.errors import OutputNotWritable
from ..._exchange.errors import sentence as failure_sentence
from ...conventions.file_paths import absolute, file_of, stored
from ...errors import PythonUnsuitable, TakeMissing
from ...solving.take_paths import capture_folder
from ..layout import draw_settings
from ..preferences import detector_for, detector_python, litert_python, note_detector, uses_included
from ..project_files import files_folder, usable
from ..properties import STEPS
from ..setting_properties import choice, path, switch
from . import base
from .base import Call, Need, RunFailed, SolverOperator, Steps, is_chosen, options

if TYPE_CHECKING:
    from ..._exchange.verb_results import DetectorResult, TakeOfVideos, VideosResult

SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts")
_LAST = list(STEPS)[-1]


def _run_steps(self: Any, context: bpy.types.Context, until: str, redo: str = "") -> Steps:
    """Run the steps up to ``until`` in the scene's video folder, and show each finished step."""
    from .import_results import bring_capture

    videos = context.scene.mocap.videos
    results, shown = file_of(videos.results), _ShownSteps(context)
    words = [str(file_of(videos.folder)), *options(out=usable(results), until=until), *videos.arguments()]
    hands = litert_python(context) if videos.hands else None
    words += options(python=detector_for(context), hand_python=hands, redo=redo)
    words += ["--hands"] if uses_included(context) and videos.fingers and not videos.hands else []
    try:
        result: VideosResult = yield Call("from-videos", words, results, of_capture=False, watch=shown.update)
    except RunFailed:
        shown.update()
        done = [STEPS[step.name][0].lower() for step in context.scene.mocap.videos.steps]
        return f"Already finished: {', '.join(done)}." if done else ""
    takes, settings, names = list(result["takes"].values()), context.scene.mocap, []
    shown.update(takes)
    for read, source in [(take["read"], Path(take["source"])) for take in takes if take["read"] is not None]:
        for capture in settings.captures:
            if capture.source and file_of(capture.source) == source:
                capture.file = stored(read["capture"])  # saving the .blend file may have moved it
        bring_capture(context, read, source)
        names.append(settings.capture.name)
    failed = [f"{name}: {failure_sentence(error)}" for name, error in result.get("failed", {}).items()]
    found = f"Captures from videos: {', '.join(names)}" if names else "The step is finished. See the panel"
    return self.finish(". ".join([found, *failed]), warn=failed)


class _ShownSteps:
    """Updates the steps in the From Videos panel while they run."""

    def __init__(self, context: bpy.types.Context) -> None:
        self._context, self._seen = context, 0

    def update(self, takes: Sequence[TakeOfVideos] = ()) -> None:
        """Read the steps' reports if they have changed. With several takes, show the take that changed last."""
        videos = self._context.scene.mocap.videos
        folders = [Path(take["folder"]) for take in takes] or _with_reports(file_of(videos.results))
        latest = max(folders, key=_changed, default=None)
        if latest is not None and (takes or _changed(latest) != self._seen):
            self._seen = _changed(latest)
            videos.take_steps(str(latest))


class MOCAP_OT_capture_from_videos(
    SolverOperator, bpy.types.Operator, base.choose_file(SUFFIXES, several=True), ImportHelper
):
    """Detect keypoints in one video per camera, calibrate the cameras, and import the take."""

    bl_label = "Capture from Videos"

    one_camera: switch("Only This Video", "Ignore the other videos in the folder", options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the settings of dropped videos, or let the user choose a folder."""
        if is_chosen(self):
            return context.window_manager.invoke_props_dialog(self, width=380)
        return ImportHelper.invoke(self, context, event)

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "one_camera")
        draw_video_settings(self.layout, context)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Make a capture from the videos in the chosen file's folder, or only from the chosen video."""
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
        return (yield from _run_steps(self, context, _LAST))


_FOLDER = Need("Choose a folder of videos first", lambda context: context.scene.mocap.videos.folder)


@base.operator("Run This Step", _FOLDER, step=str)
def video_step(self: Any, context: bpy.types.Context) -> Steps:
    """Run this step with the current settings, and repeat the steps that depend on it."""
    done = {step.name for step in context.scene.mocap.videos.steps}
    until = _LAST if _LAST in done else self.step
    return (yield from _run_steps(self, context, until, self.step if self.step in done else ""))


@base.operator("Open Image", options=base.INTERNAL, filepath=str)
def open_video_picture(self: Any, context: bpy.types.Context) -> set[str]:
    """Open this image in full size in the system's viewer."""
    drawn = {picture.name for step in context.scene.mocap.videos.steps for picture in step.pictures}
    if self.filepath not in drawn or not Path(self.filepath).is_file():
        raise TakeMissing("The image no longer exists.", where=self.filepath, hint="Run the step again.")
    return bpy.ops.wm.path_open(filepath=self.filepath)


class MOCAP_FH_videos(base.ViewportDrop, bpy.types.FileHandler):
    """Make a capture when a video is dropped on the 3D viewport."""

    bl_idname = "MOCAP_FH_videos"
    bl_label = "Capture from videos"
    bl_import_operator = "mocap.capture_from_videos"
    bl_file_extensions = ";".join(SUFFIXES)


def draw_video_settings(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the video settings that currently apply: cameras, person, delays and detector."""
    videos = context.scene.mocap.videos
    names = ["cameras"]
    names += ["board"] if videos.cameras != "person" else []
    names += ["stature"] if videos.cameras != "board" else []
    names += ["lenses"] if videos.lenses else ["lenses", "focal"]
    names += ["clocks", "detector", *(["model"] if videos.detector == "model" else [])]
    names += ["fingers" if uses_included(context) and not videos.hands else "hands", "people"]
    draw_settings(layout, context, videos, *names)


def _results(context: bpy.types.Context, folder: Path, name: str) -> Path:
    try:
        return usable(folder / name)
    except OutputNotWritable:
        return usable(capture_folder(files_folder(context.scene), folder))


def _with_reports(results: Path) -> list[Path]:
    from ...solving.take_paths import NAME

    return [path.parent for path in (*results.glob(NAME), *results.glob(f"*/{NAME}"))]


def _changed(folder: Path) -> int:
    from ...solving.take_paths import NAME

    try:
        return (folder / NAME).stat().st_mtime_ns
    except OSError:
        return 0


def draw_import_menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Draw the entry for captures from videos in File > Import."""
    self.layout.operator("mocap.capture_from_videos", text="Motion Capture from Videos (folder)")


SET_UP_DETECTOR = "set-up-detector"  # Name of a run that is not a solver verb.
_HAND_MODEL = "hand_landmark_full.tflite"
_POSE_MODELS = tuple(f"pose_landmark_{size}.tflite" for size in ("full", "heavy", "lite"))
"""Models in MediaPipe's npm package. The first one that exists is chosen."""
_ABOUT = {
    "mediapipe": "MediaPipe 0.10.21 and its dependencies, 150 MB, are installed from",
    "litert": "Google's LiteRT and NumPy, 60 MB, are installed from",
}
_MODELS = (
    "LiteRT runs models from files: put the npm packages @mediapipe/pose",
    "and @mediapipe/hands (.tgz) into the wheel folder.",
)
_WIDTH_PX = 520
"""Width of the dialog in pixels, wide enough for the folder's path."""


class MOCAP_OT_set_up_detector(SolverOperator, bpy.types.Operator):
    """Install the program that finds people in videos, in its own Python environment (asks first)."""

    bl_label = "Set Up Detector…"
    bl_options = base.OPENS | base.INTERNAL

    kind: choice("Detector", "Program that finds people in videos", "set_up_detector.kind")
    wheels: path("Wheels", "Folder with Python packages (.whl) to install (leave blank to download them)", folder=True)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from ...solving.pythons import detector_kind

        if not self.properties.is_property_set("kind"):
            self.kind = detector_kind()
        return context.window_manager.invoke_props_dialog(self, width=_WIDTH_PX)

    def draw(self, context: bpy.types.Context) -> None:
        from ...solving.pythons import environment_folder

        column = self.layout.column()
        column.row().prop(self, "kind", expand=True)
        source = "the folder below" if self.wheels else "the package registry (pypi.org)"
        for line in (_ABOUT[self.kind], source):
            column.label(text=line, translate=False)
        column.label(text=f"into {environment_folder(self.kind)}", icon="FILE_FOLDER", translate=False)
        for line in _MODELS if self.kind == "litert" else ():
            column.label(text=line, translate=False)
        column.prop(self, "wheels")

    def steps(self, context: bpy.types.Context) -> Steps:
        from ...solving import make_environment, pythons
        from ...solving.run import start_script

        if not self.wheels and not getattr(bpy.app, "online_access", True):
            hint = "Allow Online Access in Blender's preferences (System), or choose a folder of wheels."
            raise PythonUnsuitable("Online access is disabled in Blender.", where="Set Up Detector", hint=hint)
        folder = pythons.environment_folder(self.kind)
        folder.parent.mkdir(parents=True, exist_ok=True)
        python = pythons.python_to_make_with(self.kind)
        words = [str(folder), self.kind, *([str(absolute(self.wheels))] if self.wheels else [])]
        own = python if python != Path(sys.executable) else None
        script = Path(make_environment.__file__)
        result: DetectorResult = yield start_script(SET_UP_DETECTOR, script, words, own, folder.parent)
        found = note_detector(context, Path(result["python"]))
        videos = context.scene.mocap.videos
        hands = [path for path in result["models"] if Path(path).name == _HAND_MODEL]
        if hands and not videos.hands:
            videos.hands = hands[0]
        poses = [path for path in result["models"] if Path(path).name in _POSE_MODELS]
        if poses and detector_python(context) is None:
            videos.detector, videos.model = "model", min(poses, key=lambda path: _POSE_MODELS.index(Path(path).name))
        return f"The detector is set up. {found}"


@base.operator("Test Detector", options=base.INTERNAL)
def test_detector(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Check that the detector starts, and show its versions. This installs nothing."""
    from ...backend_environment import included_wheels

    if uses_included(context):
        return note_detector(context, Path(sys.executable), included_wheels())
    python = detector_for(context)
    if python is None:
        return self.give_up("No detector is set up. Press Set Up Detector, or choose a Python with one")
    return note_detector(context, python)
