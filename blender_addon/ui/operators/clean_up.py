"""Cleaning up after a solve: feet on the floor, and gaps as markers on the timeline."""

from __future__ import annotations

import bpy

from ...conventions.naming import counted
from .base import MocapOperator, NeedsTake

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


CLASSES = (MOCAP_OT_feet_to_floor, MOCAP_OT_lock_feet, MOCAP_OT_mark_gaps, MOCAP_OT_clear_marks)
