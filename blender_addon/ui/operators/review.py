"""Review and correct a take: ranges, pins, confidence, report, feet, gaps and limbs."""

from __future__ import annotations

import math

import bpy

from ..._exchange.errors import FileDamaged, FileMissing
from ...conventions.naming import counted
from ...errors import BodyUnreachable
from ..setting_properties import choice, number
from ..viewport import colour_bones
from .base import BODY, EDITABLE, OPENS, TAKE, MocapOperator, Need

_MARGIN = 5
"""Scene frames on both sides of a range to review, which the new solve has to meet."""
MARK = "gap"
"""Start of the names of our timeline markers."""
_GAP, _TO_REVIEW = f"{MARK} interpolated", f"{MARK} review"
_SAMPLES = 16
"""Frames used to measure the height of the soles, chosen by hand."""
_NOTHING_MEASURED = 1e-6
"""Maximum confidence of an interpolated frame, 0 to 1."""


_MODES = (
    ("IK", "IK", "Key hands, feet and poles, and pose limbs from their ends"),
    ("FK", "FK", "Key the joints with the IK edits, and pose limbs joint by joint"),
)
_LIMBS = (
    ("ALL", "All Limbs", "Both arms and both legs"),
    ("left_arm_ik", "Left Arm", ""),
    ("right_arm_ik", "Right Arm", ""),
    ("left_leg_ik", "Left Leg", ""),
    ("right_leg_ik", "Right Leg", ""),
)


class MOCAP_OT_next_bad_range(MocapOperator, bpy.types.Operator):
    """Go to the next frame range to review, and make it the range to solve again."""

    bl_label = "Next Range to Review"
    needs = (TAKE,)

    backwards: bool

    def work(self, context: bpy.types.Context) -> set[str]:
        from ...review.ranges import doubtful_ranges, next_range

        scene, review = context.scene, context.scene.mocap.review
        ranges = doubtful_ranges(review.take, review.below)
        found = next_range(ranges, scene.frame_current, backwards=self.backwards)
        if found is None:
            self.finish("No frame is below the threshold")
            return {"CANCELLED"}
        first, last = review.take.frame_range
        review.first = max(found[0] - _MARGIN, math.floor(first))
        review.last = min(found[1] + _MARGIN, math.ceil(last))
        scene.frame_set(found[0])
        return self.finish(f"Frames {found[0]} to {found[1]}, {ranges.index(found) + 1} of {len(ranges)}")


class MOCAP_OT_pin_pose(MocapOperator, bpy.types.Operator):
    """Keep the pose of this frame, with your edits, when the range is solved again."""

    bl_label = "Pin Current Pose"
    needs = (TAKE,)

    def work(self, context: bpy.types.Context) -> set[str]:
        review, frame = context.scene.mocap.review, context.scene.frame_current
        pin_frame(review, frame)
        review.first, review.last = min(review.first, frame), max(review.last, frame)
        return self.finish(f"Frame {frame} is pinned")


def pin_frame(review: bpy.types.PropertyGroup, frame: int) -> None:
    """Pin the body's current pose at a scene frame."""
    from ...review.ranges import pinned_values

    values = pinned_values(review.armature)
    pin = next((pin for pin in review.pins if pin.frame == frame), None) or review.pins.add()
    pin.frame, pin.job_values = frame, values


class MOCAP_OT_unpin(MocapOperator, bpy.types.Operator):
    """Let the solver change this pose again."""

    bl_label = "Unpin"

    index: int

    def work(self, context: bpy.types.Context) -> set[str]:
        context.scene.mocap.review.pins.remove(self.index)
        return self.finish()


class MOCAP_OT_show_confidence(MocapOperator, bpy.types.Operator):
    """Colour bones and skin by confidence, and mark the frames to review on the timeline."""

    bl_label = "Show Confidence"
    needs = (TAKE, EDITABLE)

    def work(self, context: bpy.types.Context) -> set[str]:
        review = context.scene.mocap.review
        review.colours = not review.colours
        colour_bones(context.scene)
        return self.finish()


class MOCAP_OT_select_body(MocapOperator, bpy.types.Operator):
    """Leave pose mode and select only the solved body."""

    bl_label = "Select Body"
    needs = (BODY,)

    def work(self, context: bpy.types.Context) -> set[str]:
        select_alone(context, context.scene.mocap.review.armature)
        return self.finish()


class MOCAP_OT_open_report(MocapOperator, bpy.types.Operator):
    """Open the page about the solve of this take."""

    bl_label = "Open Report"
    bl_options = OPENS
    needs = (TAKE,)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Open the report in the system's browser."""
        from ..._exchange.marker_formats import is_report
        from ...animation.takes import take_file

        take = context.scene.mocap.review.take
        path = take_file(take, "report_file")
        if not path.is_file():
            hint = "Solve again with Report switched on under Advanced."
            raise FileMissing("This take has no report.", where=str(path), hint=hint)
        if not is_report(path, take_file(take, "motion_file").parent):
            hint = "Solve again with Report switched on, or open it yourself if you trust it."
            message = "This file is not a report of the solver, so it is not opened."
            raise FileDamaged(message, where=str(path), hint=hint)
        return bpy.ops.wm.path_open(filepath=str(path))


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Change to object mode, unhide an object, and make it the active and only selected one.

    Raises:
        BodyUnreachable: its collection is hidden or excluded from the view layer.
    """
    if context.view_layer.objects.get(obj.name) == obj:
        obj.hide_set(False)
        obj.hide_viewport = obj.hide_select = False
    if not obj.visible_get(view_layer=context.view_layer):
        hint = "Show the collection in the outliner."
        message = "The body's collection is hidden or excluded from this view layer."
        raise BodyUnreachable(message, where=obj.name, hint=hint)
    if context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


class MOCAP_OT_feet_to_floor(MocapOperator, bpy.types.Operator):
    """Set Floor Offset so that the lower sole is on the floor in half of the frames."""

    bl_label = "Feet to Floor"
    needs = (TAKE, EDITABLE)

    def work(self, context: bpy.types.Context) -> set[str]:
        from ...review.floor_height import sole_height

        review = context.scene.mocap.review
        height = sole_height(context.scene, review.armature, review.take, _SAMPLES)
        if height is None:
            return self.give_up("The body has no skin")
        review.floor_offset -= height
        moved_mm = 1000.0 * context.scene.unit_settings.scale_length * abs(height)
        return self.finish(f"The body was {'lowered' if height > 0 else 'raised'} by {moved_mm:.0f} mm")


class MOCAP_OT_lock_feet(MocapOperator, bpy.types.Operator):
    """Add a take with your edits in which planted feet do not slide, for clips of other programs."""

    bl_label = "Lock Feet"
    needs = (
        Need(
            "This take is solved from a capture: raise Foot Lock and press Solve Again",
            lambda context: not context.scene.mocap.capture.file,
        ),
        TAKE,
        EDITABLE,
    )

    slide_mm: number("Longest Slide", "Largest slide to correct in mm, as longer ones are intentional", 100.0, 1, 500)

    def work(self, context: bpy.types.Context) -> set[str]:
        from ...retarget.locked_feet import lock_feet

        scene, review = context.scene, context.scene.mocap.review
        made = lock_feet(scene, review.take, review.armature, self.slide_mm)
        if made is None:
            return self.give_up(f"Every planted foot slides by more than {self.slide_mm:g} mm: nothing was locked")
        held = counted(made.stands, "foot contact")
        return self.finish(f"{held} locked in '{made.action.name}': feet slid by up to {made.slid_mm:.0f} mm")


class MOCAP_OT_mark_gaps(MocapOperator, bpy.types.Operator):
    """Replace our timeline markers at interpolated frame ranges and ranges to review."""

    bl_label = "Mark Gaps"
    needs = (TAKE,)

    def work(self, context: bpy.types.Context) -> set[str]:
        from ...review.ranges import doubtful_ranges

        scene, review = context.scene, context.scene.mocap.review
        remove_marks(scene)
        gaps = doubtful_ranges(review.take, _NOTHING_MEASURED)
        others = [r for r in doubtful_ranges(review.take, review.below) if not any(_meet(r, gap) for gap in gaps)]
        for name, ranges in ((_GAP, gaps), (_TO_REVIEW, others)):
            for first, last in ranges:
                scene.timeline_markers.new(f"{name} {first}-{last}", frame=first)
        return self.finish(f"{counted(len(gaps), 'interpolated range')}, {counted(len(others), 'range')} to review")


class MOCAP_OT_clear_marks(MocapOperator, bpy.types.Operator):
    """Remove our gap markers from the timeline, and keep your own markers."""

    bl_label = "Clear Gap Markers"

    def work(self, context: bpy.types.Context) -> set[str]:
        remove_marks(context.scene)
        return self.finish()


def remove_marks(scene: bpy.types.Scene) -> None:
    """Remove our markers from a scene's timeline."""
    for marker in [m for m in scene.timeline_markers if m.name.startswith((f"{_GAP} ", f"{_TO_REVIEW} "))]:
        scene.timeline_markers.remove(marker)


def _meet(a: tuple[int, int], b: tuple[int, int]) -> bool:
    return a[0] <= b[1] and b[0] <= a[1]


class MOCAP_OT_switch_limbs(MocapOperator, bpy.types.Operator):
    """Switch limbs between IK and FK with keys that keep the motion, or only the pose if there is no action."""

    bl_label = "Switch Limbs"
    needs = (BODY, EDITABLE)

    to: choice("To", "Controls to switch to", _MODES)
    limb: choice("Limb", "Limbs to switch", _LIMBS)

    def work(self, context: bpy.types.Context) -> set[str]:
        from ...body.controls.limbs import LIMBS, limb_of
        from ...scene.limb_modes import pose_by_joints, pose_from_ends

        limbs = LIMBS if self.limb == "ALL" else (limb_of(self.limb),)
        switch = pose_from_ends if self.to == "IK" else pose_by_joints
        frames = switch(context.scene.mocap.review.armature, context.scene, limbs)
        keyed = f"{counted(frames, 'frame')} keyed" if frames else "the pose is set"
        return self.finish(f"{self.to}: {keyed}")
