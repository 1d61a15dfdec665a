"""Remedies that are one press away: for what a solve found, and for why a reading failed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy

from .base import MocapOperator
from .cameras import MOCAP_OT_refine_cameras
from .clean_up import MOCAP_OT_feet_to_floor
from .solver_operator import SolverOperator


class MOCAP_OT_leave_camera_out(MocapOperator, bpy.types.Operator):
    """Leaves a camera out of the solve."""

    bl_idname = "mocap.leave_camera_out"
    bl_label = "Leave Out"
    bl_description = "Solve without this camera from now on; its checkbox under Cameras takes it back"

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
    """Reads a capture again in the manner that its failure asks for."""

    bl_idname = "mocap.read_again"
    bl_label = "Read Again"
    bl_description = "Change the reading option that this problem asks for, and read the capture again"
    is_of_capture = False

    option: bpy.props.EnumProperty(
        name="Option",
        items=(
            ("trim", "Cut to the Shortest", "Keep the frames that all cameras have"),
            ("by_order", "Count from the First", "Count each camera's frames from its first"),
        ),
    )

    def work(self, context: bpy.types.Context) -> set[str]:
        """Set the option and start reading."""
        settings = context.scene.mocap
        setattr(settings.reading, self.option, True)
        started = bpy.ops.mocap.import_capture("INVOKE_DEFAULT", filepath=settings.capture.source)
        return {"CANCELLED"} if started == {"CANCELLED"} else {"FINISHED"}


@dataclass(frozen=True)
class Fix:
    """A button that remedies what was found."""

    operator: str
    """Its ``bl_idname``."""
    text: str
    """On the button."""
    values: tuple[tuple[str, str], ...] = ()
    """Properties of the operator."""


_REFINE = Fix(MOCAP_OT_refine_cameras.bl_idname, "Refine Calibration")
_FLOOR = Fix(MOCAP_OT_feet_to_floor.bl_idname, "Feet to Floor")
_FIXES = {
    "camera_turned": _REFINE, "camera_disagrees": _REFINE,
    "feet_above_floor": _FLOOR, "floor_too_high": _FLOOR, "foot_below_floor": _FLOOR,
}  # fmt: skip
"""By the codes of diagnostics."""
_LEFT_OUT = ("contradicts", "camera_sees_little", "image_mirrored", "delay_beyond")
"""Codes of diagnostics about a camera that a solve is better off without."""


def fix_of(code: str, cameras: Sequence[str] = ()) -> Fix | None:
    """Return the remedy of a diagnostic that is a button, None where there is none.

    Args:
        code: of the diagnostic.
        cameras: that it concerns.
    """
    if code in _LEFT_OUT and cameras:
        return Fix(MOCAP_OT_leave_camera_out.bl_idname, f"Leave Out {cameras[0]}", (("camera", cameras[0]),))
    return _FIXES.get(code)


def reading_fixes(error: dict[str, str]) -> tuple[Fix, ...]:
    """Return the remedies of a failed reading that are buttons."""
    if error.get("code") != "frame_count_mismatch":
        return ()
    again = MOCAP_OT_read_again
    trim = (Fix(again.bl_idname, "Cut to the Shortest", (("option", "trim"),)),) if "--trim" in error["hint"] else ()
    return (*trim, Fix(again.bl_idname, "Frames by Order", (("option", "by_order"),)))


CLASSES = (MOCAP_OT_leave_camera_out, MOCAP_OT_read_again)
