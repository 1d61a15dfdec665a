"""Looking at a take: doubtful ranges, pins, confidence, the report."""

from __future__ import annotations

import math

import bpy

from ..._exchange.errors import FileDamaged, FileMissing
from ...errors import BodyUnreachable
from ..bone_colours import colour_bones
from .base import MocapOperator, NeedsBody, NeedsTake

_MARGIN = 5
"""Scene frames that a range to solve again reaches beyond a doubtful one, whose neighbours it must meet."""


class MOCAP_OT_next_bad_range(NeedsTake, bpy.types.Operator):
    """Goes to a doubtful frame range."""

    bl_idname = "mocap.next_bad_range"
    bl_label = "Next Doubtful Range"
    bl_description = "Go to the next stretch of frames that deserves a look, and take it as the range to solve again"

    backwards: bpy.props.BoolProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Go there."""
        from ...review.ranges import doubtful_ranges, next_range

        scene, review = context.scene, context.scene.mocap.review
        ranges = doubtful_ranges(review.take, review.below)
        found = next_range(ranges, scene.frame_current, backwards=self.backwards)
        if found is None:
            self.report({"INFO"}, "No frame is below the bound")
            return {"CANCELLED"}
        first, last = review.take.frame_range
        review.first = max(found[0] - _MARGIN, math.floor(first))
        review.last = min(found[1] + _MARGIN, math.ceil(last))
        scene.frame_set(found[0])
        self.report({"INFO"}, f"Frames {found[0]} to {found[1]}, {ranges.index(found) + 1} of {len(ranges)}")
        return {"FINISHED"}


class MOCAP_OT_pin_pose(NeedsTake, bpy.types.Operator):
    """Pins the current pose."""

    bl_idname = "mocap.pin_pose"
    bl_label = "Pin Current Pose"
    bl_description = "Keep the pose of this frame, with your edits, when its range is solved again"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Keep the pose."""
        review, frame = context.scene.mocap.review, context.scene.frame_current
        pin_frame(review, frame)
        review.first, review.last = min(review.first, frame), max(review.last, frame)
        self.report({"INFO"}, f"Frame {frame} is pinned")
        return {"FINISHED"}


def pin_frame(review: bpy.types.PropertyGroup, frame: int) -> None:
    """Pin the pose that the body stands in now, at a scene frame."""
    from ...review.pinning import pinned_values

    values = pinned_values(review.armature)
    pin = next((pin for pin in review.pins if pin.frame == frame), None) or review.pins.add()
    pin.frame, pin.job_values = frame, values


class MOCAP_OT_unpin(MocapOperator, bpy.types.Operator):
    """Takes a pin away."""

    bl_idname = "mocap.unpin"
    bl_label = "Unpin"
    bl_description = "Let the solver change this pose again"

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Take it away."""
        context.scene.mocap.review.pins.remove(self.index)
        return {"FINISHED"}


class MOCAP_OT_show_confidence(NeedsTake, bpy.types.Operator):
    """Shows confidence on bones, skin and timeline."""

    bl_idname = "mocap.show_confidence"
    bl_label = "Show Confidence"
    bl_description = (
        "Colour bones and skin by their joints' confidence on every frame, and mark doubtful frames on the timeline"
    )
    edits_body = True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Colour, or take the colours off; mode and selection stay."""
        review = context.scene.mocap.review
        review.colours = not review.colours
        colour_bones(context.scene)
        return {"FINISHED"}


class MOCAP_OT_select_body(NeedsBody, bpy.types.Operator):
    """Selects the solved body."""

    bl_idname = "mocap.select_body"
    bl_label = "Select Body"
    bl_description = "Leave pose mode and select the solved body alone"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Select it."""
        select_alone(context, context.scene.mocap.review.armature)
        return {"FINISHED"}


class MOCAP_OT_open_report(NeedsTake, bpy.types.Operator):
    """Opens the take's report."""

    bl_idname = "mocap.open_report"
    bl_label = "Open Report"
    bl_description = "Open the page about this take's solve"
    bl_options = {"REGISTER"}  # noqa: RUF012 - Blender reads a plain set

    def work(self, context: bpy.types.Context) -> set[str]:
        """Open it in the system's browser."""
        from ..._exchange.report_file import is_report
        from ...animation.takes import take_file

        path = take_file(context.scene.mocap.review.take, "report_file")
        if not path.is_file():
            raise FileMissing(
                "This take has no report.", where=str(path), hint="Solve again with Report switched on under Advanced."
            )
        motion = take_file(context.scene.mocap.review.take, "motion_file")
        if not is_report(path, motion.parent):
            raise FileDamaged(
                "This is not a report that a solve wrote beside the take, so it is not opened.",
                where=str(path),
                hint="Solve again with Report switched on, or open it yourself if you trust it.",
            )
        return bpy.ops.wm.path_open(filepath=str(path))


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Go to object mode and make an object the only selected one and the active one; a hidden one is shown again.

    Raises:
        BodyUnreachable: its collection is hidden or excluded from the view layer.
    """
    if context.view_layer.objects.get(obj.name) == obj:
        obj.hide_set(False)
        obj.hide_viewport = obj.hide_select = False
    if not obj.visible_get(view_layer=context.view_layer):
        raise BodyUnreachable(
            "The body's collection is hidden or excluded from this view layer.", where=obj.name,
            hint="Show the collection in the outliner.",
        )  # fmt: skip
    if context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


CLASSES = (
    MOCAP_OT_next_bad_range, MOCAP_OT_pin_pose, MOCAP_OT_unpin, MOCAP_OT_show_confidence,
    MOCAP_OT_select_body, MOCAP_OT_open_report,
)  # fmt: skip
