"""Looking at a take: doubtful ranges, pins, confidence, the report."""

from __future__ import annotations

import math

import bpy

from ..._exchange.errors import FileDamaged, FileMissing
from ...conventions.naming import counted
from ...errors import BodyUnreachable
from ..viewport import colour_bones
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
    from ...review.ranges import pinned_values

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


MARK = "gap"
"""How the names of our timeline markers begin."""
_SAMPLES = 16
"""Frames that the height of the soles is taken from; chosen by hand."""
_SURE = 1e-6
"""Confidence at and below which a frame is a gap, 0 to 1: nothing was measured there."""


class MOCAP_OT_feet_to_floor(NeedsTake, bpy.types.Operator):
    """Sets the floor offset so that the soles stand at zero."""

    bl_idname = "mocap.feet_to_floor"
    bl_label = "Feet to Floor"
    bl_description = "Set Floor Offset so that the lower sole stands on the floor in half of the take's frames"
    edits_body = True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Measure the skin on some frames and lift or lower the body."""
        from ...review.floor_height import sole_height

        review = context.scene.mocap.review
        height = sole_height(context.scene, review.armature, review.take, _SAMPLES)
        if height is None:
            self.report({"WARNING"}, "The body has no skin to stand on")
            return {"CANCELLED"}
        review.floor_offset -= height
        moved_mm = 1000.0 * context.scene.unit_settings.scale_length * abs(height)
        self.report({"INFO"}, f"The body was {'lowered' if height > 0 else 'raised'} by {moved_mm:.0f} mm")
        return {"FINISHED"}


class MOCAP_OT_lock_feet(NeedsTake, bpy.types.Operator):
    """Makes a take whose feet stay where they stand."""

    bl_idname = "mocap.lock_feet"
    bl_label = "Lock Feet"
    bl_description = (
        "Add a take, your edits included, in which heels and balls of standing feet stay in place. For clips of other "
        "programs, which are not solved again"
    )
    edits_body = True

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a take that no solve of a capture can hold anew."""
        if context.scene.mocap.capture.file:
            cls.poll_message_set("Choose more Foot Lock and press Solve Again: this take is solved from a capture")
            return False
        return super().poll(context)

    slide_mm: bpy.props.FloatProperty(
        name="Longest Slide",
        description="Millimetres; a foot that goes farther while it is slow and low slides on purpose",
        default=100.0, min=1.0, max=500.0,
    )  # fmt: skip

    def work(self, context: bpy.types.Context) -> set[str]:
        """Make it and play it."""
        from ...retarget.locked_feet import lock_feet

        scene, review = context.scene, context.scene.mocap.review
        made = lock_feet(scene, review.take, review.armature, self.slide_mm)
        if made is None:
            self.report({"WARNING"}, f"No foot stands without sliding over {self.slide_mm:g} mm: nothing was locked")
            return {"CANCELLED"}
        held = counted(made.stands, "stand")
        self.report({"INFO"}, f"{held} held in '{made.action.name}': feet slid by up to {made.slid_mm:.0f} mm")
        return {"FINISHED"}


class MOCAP_OT_mark_gaps(NeedsTake, bpy.types.Operator):
    """Marks bridged and doubtful ranges on the timeline."""

    bl_idname = "mocap.mark_gaps"
    bl_label = "Mark Gaps"
    bl_description = "Put timeline markers where nobody was seen and where the solve is doubtful; again to renew them"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Put the markers anew."""
        from ...review.ranges import doubtful_ranges

        scene, review = context.scene, context.scene.mocap.review
        remove_marks(scene)
        gaps = doubtful_ranges(review.take, _SURE)
        doubtful = [r for r in doubtful_ranges(review.take, review.below) if not any(_meet(r, gap) for gap in gaps)]
        for kind, ranges in (("bridged", gaps), ("doubtful", doubtful)):
            for first, last in ranges:
                scene.timeline_markers.new(f"{MARK} {kind} {first}-{last}", frame=first)
        self.report(
            {"INFO"}, f"{counted(len(gaps), 'bridged range')} and {counted(len(doubtful), 'doubtful range')} marked"
        )
        return {"FINISHED"}


class MOCAP_OT_clear_marks(MocapOperator, bpy.types.Operator):
    """Takes our markers off the timeline."""

    bl_idname = "mocap.clear_marks"
    bl_label = "Clear Gap Markers"
    bl_description = "Remove the markers of gaps from the timeline; your own stay"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Take them off."""
        remove_marks(context.scene)
        return {"FINISHED"}


def remove_marks(scene: bpy.types.Scene) -> None:
    """Take our markers off a scene's timeline."""
    for marker in [m for m in scene.timeline_markers if m.name.startswith((f"{MARK} bridged ", f"{MARK} doubtful "))]:
        scene.timeline_markers.remove(marker)


def _meet(a: tuple[int, int], b: tuple[int, int]) -> bool:
    return a[0] <= b[1] and b[0] <= a[1]


_LIMBS = (
    ("ALL", "All Limbs", "Both arms and both legs"),
    ("left_arm_ik", "Left Arm", ""),
    ("right_arm_ik", "Right Arm", ""),
    ("left_leg_ik", "Left Leg", ""),
    ("right_leg_ik", "Right Leg", ""),
)
_MODES = (
    ("IK", "IK", "Key hands, feet and poles, and pose limbs from their ends"),
    ("FK", "FK", "Key the joints with what was edited by IK, and pose limbs joint by joint"),
)


class MOCAP_OT_switch_limbs(NeedsBody, bpy.types.Operator):
    """Switches limbs to IK or to FK, the motion kept."""

    bl_idname = "mocap.switch_limbs"
    bl_label = "Switch Limbs"
    bl_description = (
        "Pose limbs from their ends (IK) or joint by joint (FK), keyed so that the motion stays as it is. Without an "
        "action the pose alone is set"
    )
    edits_body = True

    to: bpy.props.EnumProperty(name="To", items=_MODES, default="IK")
    limb: bpy.props.EnumProperty(name="Limb", items=_LIMBS, default="ALL")

    def work(self, context: bpy.types.Context) -> set[str]:
        """Key what the mode poses by, and switch."""
        from ...body.controls.limbs import LIMBS, limb_of
        from ...scene.limb_modes import pose_by_joints, pose_from_ends

        limbs = LIMBS if self.limb == "ALL" else (limb_of(self.limb),)
        switch = pose_from_ends if self.to == "IK" else pose_by_joints
        frames = switch(context.scene.mocap.review.armature, context.scene, limbs)
        what = f"{counted(frames, 'frame')} keyed" if frames else "the pose is set"
        self.report({"INFO"}, f"{self.to}: {what}")
        return {"FINISHED"}
