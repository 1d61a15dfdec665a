"""Setting up the detector that finds people in videos: asked first, made in a folder of the user's, tested."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from ..._exchange.errors import MocapError
from ...conventions.file_paths import absolute
from ..locations import RELATIVE
from ..preferences import detector_for, detector_python, note_detector
from .solver_operator import SolverOperator

if TYPE_CHECKING:
    from ..._exchange.verb_results import DetectorResult

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


CLASSES = (MOCAP_OT_set_up_detector, MOCAP_OT_test_detector)
