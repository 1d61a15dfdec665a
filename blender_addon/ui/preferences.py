"""Preferences: which Python the solver runs in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .._exchange.detectors import DETECTORS
from .._exchange.errors import MocapError
from . import ADDON

if TYPE_CHECKING:
    from ..solving.python_probe import PythonFound

_tested: dict[str, str] = {}
"""What detectors' Pythons answered when they were tested, by their paths."""


class MocapPreferences(bpy.types.AddonPreferences):
    """Per user, not per file."""

    bl_idname = ADDON

    python: bpy.props.StringProperty(
        name="Python with PyTorch",
        description="A Python 3.11 or later that has torch and NumPy, for faster solves; empty for Blender's own",
        subtype="FILE_PATH",
    )
    detector: bpy.props.StringProperty(
        name="Python with MediaPipe",
        description="A Python 3.9 or later that finds people in videos: with NumPy and MediaPipe, or onnxruntime for "
        "your own models. Empty for the environment that Set Up Detector makes",
        subtype="FILE_PATH",
    )
    acquisition: bpy.props.BoolProperty(
        name="Acquisition Tab",
        description="Show the tab Acquire beside MoCap: live markers, sensors, and the studio that makes captures",
    )
    found: bpy.props.StringProperty(name="Found", options={"SKIP_SAVE", "HIDDEN"})
    failed: bpy.props.StringProperty(name="Failed", options={"SKIP_SAVE", "HIDDEN"})

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the path, the test and what it found."""
        column = self.layout.column()
        column.label(text="The solver works with Blender's own Python. Nothing needs to be installed.", icon="INFO")
        column.separator()
        column.label(text="For faster solves, name a Python that has PyTorch:")
        row = column.split(factor=0.8, align=True)
        row.prop(self, "python", text="")
        row.operator(MOCAP_OT_test_python.bl_idname, icon="PLAY")
        column.label(text="For captures from videos, a Python that has a detector:")
        row = column.split(factor=0.8, align=True)
        row.prop(self, "detector", text="")
        row.operator("mocap.test_detector", icon="PLAY")
        row = column.row()
        row.label(text=detector_text(context), icon="OUTLINER_OB_ARMATURE", translate=False)
        row.operator("mocap.set_up_detector", icon="IMPORT")
        column.prop(self, "acquisition")
        for line in self.found.splitlines():
            column.label(text=line, icon="CHECKMARK", translate=False)
        if self.failed:
            alert = column.row()
            alert.alert = True
            alert.label(text=self.failed, icon="ERROR", translate=False)


class MOCAP_OT_test_python(bpy.types.Operator):
    """Reports what the chosen Python has."""

    bl_idname = "mocap.test_python"
    bl_label = "Test"
    bl_description = "Start the chosen Python and report its versions and devices; nothing is installed"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender reads a plain set

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask the Python and keep its answer for the panel."""
        from ..solving.python_probe import probe_python

        preferences = _preferences(context)
        if preferences is None:
            return {"CANCELLED"}
        preferences.found = preferences.failed = ""
        try:
            preferences.found = _lines(probe_python(chosen_python(context)))
        except MocapError as error:
            preferences.failed = str(error)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, preferences.found.replace("\n", ", "))
        return {"FINISHED"}


def shows_acquisition(context: bpy.types.Context) -> bool:
    """Return whether the tab of acquisition is shown: as preferred, and where the add-on is no installed one."""
    preferences = _preferences(context)
    return preferences is None or preferences.acquisition


def draw_acquisition(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the switch of the tab of acquisition, where there are preferences."""
    preferences = _preferences(context)
    if preferences is not None:
        layout.prop(preferences, "acquisition")


def chosen_python(context: bpy.types.Context) -> Path | None:
    """Return the interpreter the user chose, None for Blender's own."""
    preferences = _preferences(context)
    return Path(preferences.python) if preferences is not None and preferences.python else None


def named_detector(context: bpy.types.Context) -> Path | None:
    """Return the interpreter that the user named for finding people in videos, None without one."""
    preferences = _preferences(context)
    return Path(preferences.detector) if preferences is not None and preferences.detector else None


def detector_python(context: bpy.types.Context) -> Path | None:
    """Return the interpreter that has MediaPipe: as named, else the one that was set up; None without one."""
    from ..solving.detector.find_python import made_python

    return named_detector(context) or made_python()


def litert_python(context: bpy.types.Context) -> Path | None:
    """Return the interpreter that has LiteRT: the one that was set up, else as named; None without one."""
    from ..solving.detector.find_python import made_litert_python

    return made_litert_python() or named_detector(context)


def detector_for(context: bpy.types.Context) -> Path | None:
    """Return the interpreter that finds people with the chosen detector; None without one, or for the solver's own."""
    videos = context.scene.mocap.videos
    if _has_own_environment(videos.detector):
        return detector_python(context)
    return litert_python(context) if _is_litert(videos) else named_detector(context)


def lacks_detector(context: bpy.types.Context) -> bool:
    """Return whether the chosen detector has no Python: ONNX models run in the solver's own."""
    videos = context.scene.mocap.videos
    return (_has_own_environment(videos.detector) or _is_litert(videos)) and detector_for(context) is None


def detector_text(context: bpy.types.Context) -> str:
    """Return which detector there is, as far as is known without starting it."""
    if lacks_detector(context):
        return "No detector is set up"
    python = detector_for(context)
    if python is None:
        return "The model runs in the solver's Python"
    return _tested.get(str(python), f"Detector: {python}, not tested yet")


def _is_litert(videos: bpy.types.PropertyGroup) -> bool:
    return videos.detector == "model" and videos.model.lower().endswith(".tflite")


def _has_own_environment(detector: str) -> bool:
    return detector in DETECTORS and DETECTORS[detector].own_environment


def note_detector(context: bpy.types.Context, python: Path) -> str:
    """Start a detector's Python, keep for the panels what it has, and return it.

    Raises:
        PythonUnsuitable: it does not start.
    """
    from ..solving.detector.find_python import probe_detector

    found = _tested[str(python)] = f"Detector: {probe_detector(python)}"
    return found


def _preferences(context: bpy.types.Context) -> MocapPreferences | None:
    addon = context.preferences.addons.get(ADDON)
    return None if addon is None else addon.preferences


def _lines(found: PythonFound) -> str:
    torch = f"PyTorch {found.torch} on {', '.join(found.devices)}" if found.torch else "without PyTorch"
    return f"Python {found.python}, NumPy {found.numpy}, {torch}\nSolver {found.solver} runs in it"
