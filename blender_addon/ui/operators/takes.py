"""Takes of a body: played, thinned, laid aside on the NLA, offered as assets."""

from __future__ import annotations

import bpy

from ...errors import TakeMissing
from ..viewport import colour_markers
from .base import MocapOperator, NeedsBody, NeedsTake


class MOCAP_OT_show_take(NeedsBody, bpy.types.Operator):
    """Plays another take."""

    bl_idname = "mocap.show_take"
    bl_label = "Show Take"
    bl_description = "Play this take"
    edits_body = True

    name: bpy.props.StringProperty(options={"HIDDEN"})

    def work(self, context: bpy.types.Context) -> set[str]:
        """Play it."""
        from ...animation.takes import show_take
        from ...conventions.timing import show_frame

        scene, settings = context.scene, context.scene.mocap
        show_take(settings.review.armature, _take_named(settings, self.name))
        colour_markers(scene)
        show_frame(scene)
        return {"FINISHED"}


class MOCAP_OT_delete_take(NeedsBody, bpy.types.Operator):
    """Deletes a take."""

    bl_idname = "mocap.delete_take"
    bl_label = "Delete Take"
    bl_description = "Delete this take from the file; what the solver wrote stays on the disk"
    edits_body = True

    name: bpy.props.StringProperty(options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first."""
        return context.window_manager.invoke_confirm(self, event)

    def work(self, context: bpy.types.Context) -> set[str]:
        """Play another take of the body, if this one plays, and delete it."""
        from ...animation.takes import show_take
        from ...conventions.timing import show_frame

        settings = context.scene.mocap
        take, review = _take_named(settings, self.name), settings.review
        if not take.is_editable:
            raise TakeMissing(f"The take '{self.name}' is linked from another file and is deleted there.")
        others = [other for other in _takes(settings) if other != take]
        if review.take == take and others:
            show_take(review.armature, others[-1])
        bpy.data.actions.remove(take)
        colour_markers(context.scene)
        show_frame(context.scene)
        return {"FINISHED"}


def _takes(settings: bpy.types.PropertyGroup) -> list[bpy.types.Action]:
    """Return the takes of the capture, of the person who is looked at."""
    from ...animation.takes import takes_of

    capture = settings.capture
    return takes_of(capture.measured, capture.person.key if capture.person else "", capture.original)


def _take_named(settings: bpy.types.PropertyGroup, name: str) -> bpy.types.Action:
    """Return one of the takes.

    Raises:
        TakeMissing: none has the name.
    """
    action = next((take for take in _takes(settings) if take.name == name), None)
    if action is None:
        raise TakeMissing(f"There is no take '{name}' for this body.")
    return action


class MOCAP_OT_thin_take(NeedsTake, bpy.types.Operator):
    """Makes a take with few keys."""

    bl_idname = "mocap.thin_take"
    bl_label = "Reduce Keys"
    bl_description = (
        "Add a take of smooth curves through a few keys of this one, your edits included, and report how far it is "
        "from this one"
    )
    edits_body = True

    by: bpy.props.EnumProperty(
        name="Keep by",
        default="TOLERANCE",
        items=(
            ("RATE", "Keys a Second", "This many keys, whatever the distance"),
            ("TOLERANCE", "Tolerance", "As few keys as keep every joint within the tolerance"),
        ),
    )
    tolerance_mm: bpy.props.FloatProperty(
        name="Tolerance", description="Millimetres by which any joint may be off the full take in any frame",
        default=10.0, min=0.5, max=500.0,
    )  # fmt: skip
    keys_per_second: bpy.props.FloatProperty(
        name="Keys a Second", description="Average number of keys that are kept", default=2.0, min=0.1, max=30.0
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what counts of the options."""
        self.layout.prop(self, "by", expand=True)
        self.layout.prop(self, "tolerance_mm" if self.by == "TOLERANCE" else "keys_per_second")

    def work(self, context: bpy.types.Context) -> set[str]:
        """Make it and play it."""
        from ...scene.add_take import thinned_take

        scene, review = context.scene, context.scene.mocap.review
        limits = (None, self.tolerance_mm) if self.by == "TOLERANCE" else (self.keys_per_second, None)
        action = thinned_take(scene, review.take, review.armature, *limits)
        self.report({"INFO"}, action["keys_deviation"])
        return {"FINISHED"}


class MOCAP_OT_push_down(NeedsTake, bpy.types.Operator):
    """Lays the take aside on the NLA."""

    bl_idname = "mocap.push_down"
    bl_label = "Push Down to NLA"
    bl_description = "Move this take to a strip on an NLA track of its name; the body plays on from there"
    edits_body = True

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a take that is an action of the body's own."""
        if not super().poll(context):
            return False
        if context.scene.mocap.review.armature.animation_data.action is None:
            cls.poll_message_set("The take is on the NLA already")
            return False
        return True

    def work(self, context: bpy.types.Context) -> set[str]:
        """Move it, and let the track be heard."""
        from ...animation.takes import push_down

        review = context.scene.mocap.review
        armature, name = review.armature, review.take.name
        push_down(armature)
        armature.animation_data.nla_tracks[-1].mute = False
        self.report({"INFO"}, f"'{name}' plays on an NLA track of its name")
        return {"FINISHED"}


class MOCAP_OT_mark_take(NeedsTake, bpy.types.Operator):
    """Offers the take in the asset browser."""

    bl_idname = "mocap.mark_take"
    bl_label = "Mark as Asset"
    bl_description = "Offer this take in the asset browser, with its length and frame rate"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Mark it."""
        from ...animation.takes import mark_as_asset

        take = context.scene.mocap.review.take
        mark_as_asset(take)
        self.report({"INFO"}, f"'{take.name}' is an asset of this file")
        return {"FINISHED"}


class MOCAP_OT_follow_rate(MocapOperator, bpy.types.Operator):
    """Lays everything anew at the scene's frame rate."""

    bl_idname = "mocap.follow_rate"
    bl_label = "Follow Frame Rate"
    bl_description = "Resample takes, detections, footage, confidence and pins to the scene's frame rate"

    def work(self, context: bpy.types.Context) -> set[str]:
        """Lay them."""
        from ...conventions.timing import scene_frame_rate, show_frame
        from ...scene.frame_rate import relay

        scene, settings = context.scene, context.scene.mocap
        ratio = relay(scene, takes_of_captures(scene))
        for capture in settings.captures:
            for item in capture.left_out:
                start = capture.frame_start
                item.first, item.last = (round(start + (frame - start) * ratio) for frame in (item.first, item.last))
            for review in capture.reviews:
                _relay_review(review, capture.frame_start, ratio)
        show_frame(scene)
        self.report({"INFO"}, f"Everything is laid by time at {scene_frame_rate(scene):g} fps")
        return {"FINISHED"}


def _relay_review(review: bpy.types.PropertyGroup, start: int, ratio: float) -> None:
    for pin in review.pins:
        pin.frame = round(start + (pin.frame - start) * ratio)
    ends = (review.first, review.last)
    review.first, review.last = (round(start + (frame - start) * ratio) for frame in ends)


def takes_of_captures(scene: bpy.types.Scene) -> list[bpy.types.Action]:
    """Return the takes of a scene's captures, played or not."""
    from ...animation.curves import is_take
    from ...animation.takes import takes_of

    return [
        action
        for capture in scene.mocap.captures
        for action in takes_of(capture.measured, original=capture.original)
        if is_take(action)
    ]
