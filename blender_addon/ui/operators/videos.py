"""A capture from videos: by button, by menu, by dropping a video on the viewport; each step again, alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy
from bpy_extras.io_utils import ImportHelper

from ..._exchange.errors import MocapError, OutputNotWritable, sentence
from ...conventions.file_paths import absolute, file_of, stored
from ...errors import TakeMissing
from ..layout import draw_setting, settings_layout
from ..preferences import detector_for, detector_python, litert_python, note_detector
from ..project_files import RELATIVE, files_folder, usable
from ..properties import STEPS
from .base import MocapOperator, SolverOperator, ViewportDrop, current

if TYPE_CHECKING:
    from ..._exchange.verb_results import CaptureResult, DetectorResult, TakeOfVideos, VideosResult

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


_HAND_MODEL = "hand_landmark_full.tflite"
_POSE_MODELS = tuple(f"pose_landmark_{size}.tflite" for size in ("full", "heavy", "lite"))
"""Models of people in MediaPipe's npm package; the first of those that are there is chosen."""
VERB = "set-up-detector"
"""Name of such a run; it is no verb of the solver's."""


_KINDS = (
    ("mediapipe", "MediaPipe", "Finds people, and hands; its models are in its wheel; Python 3.9 to 3.12"),
    ("litert", "LiteRT", "Runs MediaPipe's models of people and hands as files; Python 3.10 to 3.14"),
)
_ABOUT = {
    "mediapipe": "MediaPipe 0.10.21 and what it needs, 150 MB, are installed from",
    "litert": "Google's LiteRT and NumPy, 60 MB, are installed from",
}
_MODELS = (
    "It runs models as files: put the npm packages @mediapipe/pose",
    "and @mediapipe/hands (.tgz) beside the wheels.",
)
_WIDTH_PX = 520
"""Of the question: the folder has a line."""


class MOCAP_OT_set_up_detector(SolverOperator, bpy.types.Operator):
    """Makes an environment with MediaPipe or LiteRT, after asking."""

    bl_idname = "mocap.set_up_detector"
    bl_label = "Set Up Detector…"
    bl_description = (
        "Make an environment with MediaPipe or LiteRT, which find people in videos; asks before anything is installed"
    )
    bl_options = {"REGISTER", "INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    is_of_capture = False

    kind: bpy.props.EnumProperty(name="Detector", description="What is set up", items=_KINDS)
    wheels: bpy.props.StringProperty(
        name="Wheels", subtype="DIR_PATH", options=RELATIVE,
        description="Folder of wheels to install from without a network; empty for the package registry",
    )  # fmt: skip

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask."""
        return context.window_manager.invoke_props_dialog(self, width=_WIDTH_PX)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what is installed, from where and into which folder."""
        from ...solving.detector.find_python import environment_folder

        column = self.layout.column()
        column.row().prop(self, "kind", expand=True)
        column.label(text=_ABOUT[self.kind], translate=False)
        column.label(text="the folder below" if self.wheels else "the package registry (pypi.org)", translate=False)
        column.label(text=f"into {environment_folder(self.kind)}", icon="FILE_FOLDER", translate=False)
        for line in _MODELS if self.kind == "litert" else ():
            column.label(text=line, translate=False)
        column.prop(self, "wheels")

    def work(self, context: bpy.types.Context) -> set[str]:
        """Start."""
        import sys

        from ...errors import PythonUnsuitable
        from ...solving.detector import find_python, make_environment
        from ...solving.run import start_script

        if not self.wheels and not getattr(bpy.app, "online_access", True):
            hint = "Allow Online Access in Blender's preferences (System), or choose a folder of wheels."
            raise PythonUnsuitable("Blender is set to stay offline.", where="Set Up Detector", hint=hint)
        folder = find_python.environment_folder(self.kind)
        folder.parent.mkdir(parents=True, exist_ok=True)
        python = find_python.python_to_make_with(self.kind)
        arguments = [str(folder), self.kind, *([str(absolute(self.wheels))] if self.wheels else [])]
        own = python if python != Path(sys.executable) else None
        return self.follow(context, start_script(VERB, Path(make_environment.__file__), arguments, own, folder.parent))

    def received(self, context: bpy.types.Context, result: DetectorResult) -> set[str]:
        """Report what there is now."""
        found = note_detector(context, Path(result["python"]))
        videos = context.scene.mocap.videos
        hands = [path for path in result["models"] if Path(path).name == _HAND_MODEL]
        if hands and not videos.hands:
            videos.hands = hands[0]
        poses = [path for path in result["models"] if Path(path).name in _POSE_MODELS]
        if poses and detector_python(context) is None:
            videos.detector, videos.model = "model", min(poses, key=lambda path: _POSE_MODELS.index(Path(path).name))
        self.report({"INFO"}, f"The detector is set up. {found}")
        return {"FINISHED"}


class MOCAP_OT_test_detector(bpy.types.Operator):
    """Reports which detector there is."""

    bl_idname = "mocap.test_detector"
    bl_label = "Test"
    bl_description = "Start the detector's Python and report what it has; nothing is installed"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask it."""
        python = detector_for(context)
        if python is None:
            self.report({"WARNING"}, "No detector is set up: press Set Up Detector, or name a Python that has one")
            return {"CANCELLED"}
        try:
            self.report({"INFO"}, note_detector(context, python))
        except MocapError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}
