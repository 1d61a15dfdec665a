"""Remedies that are one press away: for what a solve found, and for why a reading failed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy

from ..._exchange.diagnostics import Diagnostic
from ..._exchange.errors import ErrorEvent
from .base import MocapOperator, SolverOperator
from .cameras import MOCAP_OT_refine_cameras
from .review import MOCAP_OT_feet_to_floor


class MOCAP_OT_leave_camera_out(MocapOperator, bpy.types.Operator):
    """Leaves a camera out of the solve."""

    bl_idname = "mocap.leave_camera_out"
    bl_label = "Leave Out"
    bl_description = "Solve without this camera from now on; tick it under Cameras to use it again"

    camera: bpy.props.StringProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Clear its checkbox."""
        item = next((item for item in context.scene.mocap.capture.cameras if item.name == self.camera), None)
        if item is None:
            self.report({"WARNING"}, f"The capture has no camera '{self.camera}'")
            return {"CANCELLED"}
        item.use = False
        self.report({"INFO"}, f"'{self.camera}' is left out: solve again")
        return {"FINISHED"}


class MOCAP_OT_read_again(SolverOperator, bpy.types.Operator):
    """Reads a capture again in the manner that a problem asks for."""

    bl_idname = "mocap.read_again"
    bl_label = "Read Again"
    bl_description = "Change the reading option that this problem is about, and read the capture again"
    is_of_capture = False

    option: bpy.props.StringProperty(options={"HIDDEN"})
    value: bpy.props.StringProperty(options={"HIDDEN"}, default="on")

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Return which option is set to what."""
        prop = _group_of(context, properties.option).bl_rna.properties.get(properties.option)
        name = properties.option if prop is None else prop.name
        return f"Set {name} to {properties.value}, and read the capture again"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Set the option and start reading."""
        group = _group_of(context, self.option)
        try:
            setattr(group, self.option, type(getattr(group, self.option))(self.value))
        except (AttributeError, TypeError, ValueError):  # the option or its value is from a file
            self.report({"ERROR"}, f"Reading Options have no {self.option} '{self.value}'")
            return {"CANCELLED"}
        source = context.scene.mocap.capture.source
        started = bpy.ops.mocap.import_capture("INVOKE_DEFAULT", filepath=source)
        return {"CANCELLED"} if started == {"CANCELLED"} else {"FINISHED"}


def _group_of(context: bpy.types.Context, option: str) -> bpy.types.PropertyGroup:
    """Return the settings that a reading option stands in: whether cameras are synchronised is of the solve, too."""
    settings = context.scene.mocap
    return settings.solve if option == "sync" else settings.reading


@dataclass(frozen=True)
class Fix:
    """A button that remedies what was found."""

    operator: str
    """Its ``bl_idname``."""
    text: str
    """On the button."""
    values: tuple[tuple[str, str], ...] = ()
    """Properties of the operator."""
    is_choice: bool = False
    """Whether it undoes what the reader did for a reason, or is right for one of two causes: only the user knows."""


def _again(text: str, option: str, value: str, *, is_choice: bool = True) -> Fix:
    """Return the fix that reads again with an option."""
    return Fix(MOCAP_OT_read_again.bl_idname, text, (("option", option), ("value", value)), is_choice)


_REFINE = Fix(MOCAP_OT_refine_cameras.bl_idname, "Refine Calibration")
_FLOOR = Fix(MOCAP_OT_feet_to_floor.bl_idname, "Feet to Floor")
_AS_WRITTEN = _again("As Written", "as_calibrated", "on")
_KEEP_LEVEL = _again("Keep Its Level", "level", "off")
_LEVEL = _again("Level by the Person", "level", "on", is_choice=False)
_AS_RECORDED = _again("As Recorded", "sync", "off")
_FIXES = {
    "camera_turned": _REFINE, "camera_disagrees": _REFINE, "camera_moved": _REFINE, "cameras_shifted": _REFINE,
    "feet_above_floor": _FLOOR, "floor_too_high": _FLOOR, "foot_below_floor": _FLOOR,
    "calibration_corrected": _AS_WRITTEN, "detections_corrected": _AS_WRITTEN, "camera_names_exchanged": _AS_WRITTEN,
    "world_levelled": _KEEP_LEVEL, "floor_by_feet": _KEEP_LEVEL,
    "floor_off": _LEVEL, "person_tilted": _LEVEL,
    "starts_apart": _AS_RECORDED, "start_ambiguous": _AS_RECORDED,
    "unit_by_person": _again("Read as {guessed}", "unit", "{guessed}"),
    "marker_unit_not_as_stated": _again("Read as {stated}", "unit", "{stated}"),
    "up_by_person": _again("Keep Z Up", "up_axis", "z"),
    "person_along_axis": _again("Take {axis} as Up", "up_axis", "{axis}", is_choice=False),
    "frame_rate_contradicts": _again("Read at {video:g} fps", "fps", "{video:g}"),
    "takes_joined": _again("Frames 0-{first_end}", "frames", "0 {first_end}"),
}  # fmt: skip
"""By the codes of diagnostics; texts and values hold the diagnostic's values."""
_LEFT_OUT = ("contradicts", "camera_sees_little", "image_mirrored", "delay_beyond", "camera_sees_elsewhere")
"""Codes of diagnostics about a camera that a solve is better off without."""


def fix_of(found: Diagnostic) -> Fix | None:
    """Return the remedy of a diagnostic that is a button, None where there is none."""
    if found.code in _LEFT_OUT and found.where.cameras:
        camera = found.where.cameras[0]
        return Fix(MOCAP_OT_leave_camera_out.bl_idname, f"Leave Out {camera}", (("camera", camera),))
    fix = _FIXES.get(found.code)
    if fix is None:
        return None
    try:
        values = tuple((name, value.format(**found.values).lower()) for name, value in fix.values)
        return replace(fix, text=fix.text.format(**found.values), values=values)
    except (KeyError, TypeError, ValueError):  # a file of another version
        return None


def reading_fixes(error: ErrorEvent) -> tuple[Fix, ...]:
    """Return the remedies of a failed reading that are buttons."""
    if error.get("code") != "frame_count_mismatch":
        return ()
    trim = (_again("Cut to the Shortest", "trim", "on"),) if "--trim" in error["hint"] else ()
    return (*trim, _again("Frames by Order", "by_order", "on"))
