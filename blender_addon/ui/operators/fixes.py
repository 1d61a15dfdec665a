"""Remedies at the press of a button: for findings of a solve, and for reasons why a reading failed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import bpy

from ..._exchange.diagnostics import Diagnostic
from ..._exchange.errors import ErrorEvent
from .base import IDLE, MocapOperator, operator


@operator("Leave Out", camera=str)
def leave_camera_out(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Solve without this camera, until you tick it under Cameras again."""
    item = next((item for item in context.scene.mocap.capture.cameras if item.name == self.camera), None)
    if item is None:
        return self.give_up(f"The capture has no camera '{self.camera}'")
    item.use = False
    return f"'{self.camera}' is excluded: solve again"


class MOCAP_OT_read_again(MocapOperator, bpy.types.Operator):
    """Change the reading option behind this problem, and read the capture again."""

    bl_label = "Read Again"
    needs = (IDLE,)

    option: str
    value: str = "on"

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        prop = _group_of(context, properties.option).bl_rna.properties.get(properties.option)
        name = properties.option if prop is None else prop.name
        return f"Set {name} to {properties.value}, and read the capture again"

    def work(self, context: bpy.types.Context) -> set[str]:
        group = _group_of(context, self.option)
        try:
            setattr(group, self.option, type(getattr(group, self.option))(self.value))
        except (AttributeError, TypeError, ValueError):  # the option or its value comes from a file
            return self.give_up(f"Reading Options have no {self.option} '{self.value}'", "ERROR")
        source = context.scene.mocap.capture.source
        started = bpy.ops.mocap.import_capture("INVOKE_DEFAULT", filepath=source)
        return {"CANCELLED"} if started == {"CANCELLED"} else {"FINISHED"}


def _group_of(context: bpy.types.Context, option: str) -> bpy.types.PropertyGroup:
    """Return the group with a reading option. Synchronisation is also a setting of the solve."""
    settings = context.scene.mocap
    return settings.solve if option == "sync" else settings.reading


@dataclass(frozen=True)
class Fix:
    """A button that remedies a finding."""

    operator: str
    """Its ``bl_idname``."""
    text: str
    values: tuple[tuple[str, str], ...] = ()
    """Properties of the operator."""
    is_choice: bool = False
    """Whether only the user can decide, as the fix undoes a correction or suits one of two causes."""


def _again(text: str, option: str, value: str, *, is_choice: bool = True) -> Fix:
    return Fix("mocap.read_again", text, (("option", option), ("value", value)), is_choice)


_REFINE = Fix("mocap.refine_cameras", "Refine Calibration")
_FLOOR = Fix("mocap.feet_to_floor", "Feet to Floor")
_FIXES = {
    _REFINE: "camera_turned camera_disagrees camera_moved cameras_shifted",
    _FLOOR: "feet_above_floor floor_too_high foot_below_floor",
    _again("As Written", "as_calibrated", "on"): (
        "calibration_corrected camera_placed detections_corrected camera_names_exchanged"
    ),
    _again("Keep Its Level", "level", "off"): "world_levelled floor_by_feet",
    _again("Level by the Person", "level", "on", is_choice=False): "floor_off person_tilted",
    _again("As Recorded", "sync", "off"): "starts_apart start_ambiguous",
    _again("Read as {guessed}", "unit", "{guessed}"): "unit_by_person",
    _again("Read as {stated}", "unit", "{stated}"): "marker_unit_not_as_stated",
    _again("Keep Z Up", "up_axis", "z"): "up_by_person",
    _again("Take {axis} as Up", "up_axis", "{axis}", is_choice=False): "person_along_axis",
    _again("Read at {video:g} fps", "fps", "{video:g}"): "frame_rate_contradicts",
    _again("Frames 0-{first_end}", "frames", "0 {first_end}"): "takes_joined",
}
"""Codes of the diagnostics that each fix remedies. Texts and values contain the diagnostic's values."""
_FIX_OF = {code: fix for fix, codes in _FIXES.items() for code in codes.split()}
_LEFT_OUT = ("contradicts", "camera_sees_little", "image_mirrored", "delay_beyond", "camera_sees_elsewhere")
"""Codes of diagnostics about a camera that makes the solve worse."""


def fix_of(found: Diagnostic) -> Fix | None:
    """Return the fix of a diagnostic, None if it has no button."""
    if found.code in _LEFT_OUT and found.where.cameras:
        camera = found.where.cameras[0]
        return Fix("mocap.leave_camera_out", f"Leave Out {camera}", (("camera", camera),))
    fix = _FIX_OF.get(found.code)
    if fix is None:
        return None
    try:
        values = tuple((name, value.format(**found.values).lower()) for name, value in fix.values)
        return replace(fix, text=fix.text.format(**found.values), values=values)
    except (KeyError, TypeError, ValueError):  # a file with other values
        return None


def reading_fixes(error: ErrorEvent) -> tuple[Fix, ...]:
    """Return the fixes of a failed reading."""
    if error.get("code") != "frame_count_mismatch":
        return ()
    trim = (_again("Cut to the Shortest", "trim", "on"),) if "--trim" in error["hint"] else ()
    return (*trim, _again("Frames by Order", "by_order", "on"))
