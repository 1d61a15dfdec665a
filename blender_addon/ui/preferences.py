"""Preferences: which Python the solver runs in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from .._exchange.errors import MocapError
from . import ADDON

if TYPE_CHECKING:
    from ..solving.python_probe import PythonFound


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
        description="A Python 3.9 or later that has MediaPipe and NumPy, or onnxruntime for models of yours, in which "
        "people are found in videos; empty for the environment that dev.py makes",
        subtype="FILE_PATH",
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
        column.prop(self, "detector", text="")
        for line in self.found.splitlines():
            column.label(text=line, icon="CHECKMARK", translate=False)
        if self.failed:
            alert = column.row()
            alert.alert = True
            alert.label(text=self.failed, icon="ERROR", translate=False)


class MOCAP_OT_test_python(bpy.types.Operator):
    """Says what the chosen Python has."""

    bl_idname = "mocap.test_python"
    bl_label = "Test"
    bl_description = "Start the chosen Python and say which versions and devices it has; nothing is installed"
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


def chosen_python(context: bpy.types.Context) -> Path | None:
    """Return the interpreter the user chose, None for Blender's own."""
    preferences = _preferences(context)
    return Path(preferences.python) if preferences is not None and preferences.python else None


def detector_python(context: bpy.types.Context) -> Path | None:
    """Return the interpreter that people are found in videos with, None for the solver's own choice."""
    preferences = _preferences(context)
    return Path(preferences.detector) if preferences is not None and preferences.detector else None


def _preferences(context: bpy.types.Context) -> MocapPreferences | None:
    addon = context.preferences.addons.get(ADDON)
    return None if addon is None else addon.preferences


def _lines(found: PythonFound) -> str:
    torch = f"PyTorch {found.torch} on {', '.join(found.devices)}" if found.torch else "without PyTorch"
    return f"Python {found.python}, NumPy {found.numpy}, {torch}\nSolver {found.solver} runs in it"
