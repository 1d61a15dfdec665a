"""Preferences: the Python installations of the solver and the detector, and the Acquire tab."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy

from .._exchange.errors import MocapError
from .._exchange.video_settings import DETECTORS, LARGEST_DESCRIPTION, MEDIAPIPE
from ..conventions.file_paths import file_of
from . import ADDON
from .setting_properties import path, switch

_tested: dict[str, str] = {}  # Package versions found in each tested detector Python, by path.
_WHOLE: dict[str, Any] = {"options": set()}


class MocapPreferences(bpy.types.AddonPreferences):
    """Settings that apply to all files of the user."""

    bl_idname = ADDON

    python: path(
        "Python with PyTorch",
        "Python 3.11 or later with torch and NumPy, for faster solves (leave blank to use Blender's Python)",
        **_WHOLE,
    )
    detector: path(
        "Python with MediaPipe",
        "Python 3.9 or later with NumPy and MediaPipe or onnxruntime (leave blank to use the one from Set Up Detector)",
        **_WHOLE,
    )
    acquisition: switch("Acquire Tab", "Show the tab for live capture, the sensor array and the studio")
    found: str
    failed: str

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the chosen Pythons, their test buttons and the test results."""
        column = self.layout.column()
        column.label(text="The solver runs in Blender's own Python. Nothing needs to be installed.", icon="INFO")
        column.separator()
        for text, name, operator in (
            ("For faster solves, choose a Python with PyTorch:", "python", "mocap.test_python"),
            ("For captures from videos, choose a Python with a detector:", "detector", "mocap.test_detector"),
        ):
            column.label(text=text)
            row = column.split(factor=0.8, align=True)
            row.prop(self, name, text="")
            row.operator(operator, icon="PLAY")
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


def shows_acquisition(context: bpy.types.Context) -> bool:
    """Return whether the Acquire tab is shown. It is always shown if the add-on runs from the source tree."""
    preferences = preferences_of(context)
    return preferences is None or preferences.acquisition


def draw_acquisition(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the switch of the Acquire tab if there are preferences."""
    preferences = preferences_of(context)
    if preferences is not None:
        layout.prop(preferences, "acquisition")


def chosen_python(context: bpy.types.Context, name: str = "python") -> Path | None:
    """Return the Python that the user chose for the solver or for the ``detector``, or None."""
    path = getattr(preferences_of(context), name, "")
    return Path(path) if path else None


def detector_python(context: bpy.types.Context) -> Path | None:
    """Return the Python that runs MediaPipe: the chosen one, or else the one that was set up."""
    from ..solving.pythons import made_python

    return chosen_python(context, "detector") or made_python()


def litert_python(context: bpy.types.Context) -> Path | None:
    """Return the Python that runs LiteRT: the one that was set up, or else the chosen one."""
    from ..solving.pythons import made_litert_python

    return made_litert_python() or chosen_python(context, "detector")


def uses_included(context: bpy.types.Context) -> bool:
    """Return whether the included MediaPipe is used, which runs in Blender's Python."""
    from ..backend_environment import included_wheels
    from ..solving.pythons import made_python

    if context.scene.mocap.videos.detector != MEDIAPIPE or chosen_python(context, "detector") is not None:
        return False
    return chosen_python(context) is None and included_wheels() is not None and made_python() is None


def detector_for(context: bpy.types.Context) -> Path | None:
    """Return the Python of the chosen detector, or None if it is missing or is the solver's Python."""
    videos = context.scene.mocap.videos
    if uses_included(context):
        return None
    if videos.detector in DETECTORS and DETECTORS[videos.detector].own_environment:
        return detector_python(context)
    return litert_python(context) if _is_litert(videos) else chosen_python(context, "detector")


def lacks_detector(context: bpy.types.Context) -> bool:
    """Return whether the chosen detector still needs a Python. ONNX models run in the solver's Python.

    LiteRT models run in Blender's Python if the extension includes LiteRT.
    """
    from ..backend_environment import included_wheels

    videos = context.scene.mocap.videos
    if uses_included(context):
        return False
    needs_own = videos.detector in DETECTORS and DETECTORS[videos.detector].own_environment
    needs_litert = _is_litert(videos) and (included_wheels() is None or chosen_python(context) is not None)
    return (needs_own or needs_litert) and detector_for(context) is None


def detector_text(context: bpy.types.Context) -> str:
    """Return a sentence about the detector without starting it."""
    if lacks_detector(context):
        return "No detector is set up. Press Set Up Detector, or install the zip that includes one"
    if uses_included(context):
        return "The included detector finds body and hands"
    python = detector_for(context)
    if python is None:
        return "The model runs in the solver's Python"
    return _tested.get(str(python), f"Detector: {python}, not tested yet")


def _is_litert(videos: bpy.types.PropertyGroup) -> bool:
    """Return whether the chosen model, or the model named in a description, needs LiteRT."""
    model = videos.model
    if model.lower().endswith(".json"):
        from .._exchange.json_file import read_json_file  # so that registering does not load JSON

        with suppress(MocapError):
            described = read_json_file(file_of(model), LARGEST_DESCRIPTION)
            model = str(described.get("model")) if isinstance(described, dict) else ""
    return videos.detector == "model" and model.lower().endswith(".tflite")


def note_detector(context: bpy.types.Context, python: Path, packages: Path | None = None) -> str:
    """Start a detector's Python, then store and return its package versions."""
    from ..solving.pythons import probe_detector

    found = _tested[str(python)] = f"Detector: {probe_detector(python, packages)}"
    return found


def preferences_of(context: bpy.types.Context) -> MocapPreferences | None:
    """Return the preferences, or None if the add-on runs from the source tree."""
    addon = context.preferences.addons.get(ADDON)
    return None if addon is None else addon.preferences
