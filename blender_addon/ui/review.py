"""Looking at a take: doubtful stretches, views, pins, takes, the report."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..bake.cameras import look_through
from ..bake.confidence_lane import read_lane
from ..bake.solved_takes import show_take, takes_of
from ..review.pinning import pinned_values
from ..review.ranges import bad_ranges, next_range
from .bone_colours import colour_bones
from .solve import current_take

_MARGIN = 5
"""Scene frames a range reaches beyond a doubtful stretch, whose neighbours it must meet."""


class _NeedsTake:
    """Poll of operators that need a solved take."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a solved take."""
        if current_take(context.scene) is None:
            cls.poll_message_set("Solve a capture first")
            return False
        return True


class MOCAP_OT_next_bad_range(_NeedsTake, bpy.types.Operator):
    """Goes to a doubtful stretch."""

    bl_idname = "mocap.next_bad_range"
    bl_label = "Next Doubtful Range"
    bl_description = "Go to the next stretch of frames that deserves a look, and take it as the range to solve again"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    backwards: bpy.props.BoolProperty(options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Go there."""
        scene = context.scene
        ranges = doubtful_ranges(scene)
        if not ranges:
            self.report({"INFO"}, "No frame is below the bound")
            return {"CANCELLED"}
        found = next_range(ranges, scene.frame_current, backwards=self.backwards)
        assert found is not None
        review = scene.mocap.review
        review.first = max(found[0] - _MARGIN, scene.frame_start)
        review.last = min(found[1] + _MARGIN, scene.frame_end)
        scene.frame_set(found[0])
        self.report({"INFO"}, f"Frames {found[0]} to {found[1]}, {ranges.index(found) + 1} of {len(ranges)}")
        return {"FINISHED"}


class MOCAP_OT_pin_pose(_NeedsTake, bpy.types.Operator):
    """Pins the current pose."""

    bl_idname = "mocap.pin_pose"
    bl_label = "Pin Current Pose"
    bl_description = "Keep the pose of this frame, with your edits, when its range is solved again"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Keep the pose."""
        scene, review = context.scene, context.scene.mocap.review
        frame = scene.frame_current
        pin = next((pin for pin in review.pins if pin.frame == frame), None) or review.pins.add()
        pin.frame, pin.job_values = frame, pinned_values(review.armature)
        review.first, review.last = min(review.first, frame), max(review.last, frame)
        self.report({"INFO"}, f"Frame {frame} is pinned")
        return {"FINISHED"}


class MOCAP_OT_unpin(bpy.types.Operator):
    """Takes a pin away."""

    bl_idname = "mocap.unpin"
    bl_label = "Unpin"
    bl_description = "Let the solver change this pose again"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Take it away."""
        context.scene.mocap.review.pins.remove(self.index)
        return {"FINISHED"}


class MOCAP_OT_show_take(bpy.types.Operator):
    """Plays another take."""

    bl_idname = "mocap.show_take"
    bl_label = "Show Take"
    bl_description = "Play this take"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    name: bpy.props.StringProperty(options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a body."""
        return context.scene.mocap.review.armature is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Play it."""
        armature = context.scene.mocap.review.armature
        action = next((a for a in takes_of(context.scene.mocap.capture.file) if a.name == self.name), None)
        if action is None:
            self.report({"ERROR"}, f"There is no take '{self.name}' for this body")
            return {"CANCELLED"}
        show_take(armature, action)
        context.scene.frame_set(context.scene.frame_current)
        return {"FINISHED"}


class MOCAP_OT_show_confidence(_NeedsTake, bpy.types.Operator):
    """Paints bones by confidence."""

    bl_idname = "mocap.show_confidence"
    bl_label = "Show Confidence"
    bl_description = "Select the body in pose mode, with each bone painted by its joint's confidence on every frame"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Enter pose mode and paint, or take the paint off."""
        review = context.scene.mocap.review
        review.colours = not review.colours
        if review.colours:
            select_alone(context, review.armature)
            bpy.ops.object.mode_set(mode="POSE")
        colour_bones(context.scene)
        return {"FINISHED"}


class MOCAP_OT_select_body(bpy.types.Operator):
    """Selects the solved body."""

    bl_idname = "mocap.select_body"
    bl_label = "Select Body"
    bl_description = "Leave pose mode and select the solved body alone"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Needs a body."""
        return context.scene.mocap.review.armature is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Select it."""
        select_alone(context, context.scene.mocap.review.armature)
        return {"FINISHED"}


def select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Go to object mode and make an object the only selected one and the active one."""
    if context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj


class MOCAP_OT_open_report(_NeedsTake, bpy.types.Operator):
    """Opens the take's report."""

    bl_idname = "mocap.open_report"
    bl_label = "Open Report"
    bl_description = "Open the page about this take's solve"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Open it in the system's browser."""
        take = current_take(context.scene)
        assert take is not None
        path = Path(take.get("report_file") or "")
        if not path.is_file():
            self.report({"ERROR"}, f"There is no report at {path}: solve again with Report switched on")
            return {"CANCELLED"}
        return bpy.ops.wm.path_open(filepath=str(path))


class MOCAP_OT_view_camera(bpy.types.Operator):
    """Looks through one of the capture's cameras."""

    bl_idname = "mocap.view_camera"
    bl_label = "Look Through Camera"
    bl_description = "Look through this camera, with the body over its footage"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    index: bpy.props.IntProperty(options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make it the scene's camera, show its detections alone, and turn the viewport to it."""
        cameras = context.scene.mocap.capture.cameras
        chosen = cameras[self.index].object if self.index < len(cameras) else None
        if chosen is None:
            self.report({"ERROR"}, "This camera was deleted; import the capture again")
            return {"CANCELLED"}
        look_through(context.scene, chosen)
        _show_detections(context.scene, chosen)
        if _in_viewport(context):
            context.space_data.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}


class MOCAP_OT_leave_camera(bpy.types.Operator):
    """Leaves the camera's view."""

    bl_idname = "mocap.leave_camera"
    bl_label = "Leave Camera"
    bl_description = "Look at the scene freely again, with the detections of all cameras and the whole floor"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads a plain set

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only in a camera's view."""
        return in_camera_view(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Turn to perspective."""
        _show_detections(context.scene, None)
        context.space_data.region_3d.view_perspective = "PERSP"
        return {"FINISHED"}


def in_camera_view(context: bpy.types.Context) -> bool:
    """Return whether the viewport looks through a camera."""
    return _in_viewport(context) and context.space_data.region_3d.view_perspective == "CAMERA"


def _in_viewport(context: bpy.types.Context) -> bool:
    return context.space_data is not None and context.space_data.type == "VIEW_3D"


def _show_detections(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> None:
    """Show the detections of one camera, or of all; before footage the floor is lines alone."""
    capture = scene.mocap.capture
    for item in capture.cameras:
        if item.detections is not None:
            item.detections.hide_viewport = camera is not None and item.object != camera
    if capture.floor is not None:
        capture.floor.display_type = "TEXTURED" if camera is None else "WIRE"


def doubtful_ranges(scene: bpy.types.Scene) -> list[tuple[int, int]]:
    """Return [first, last] scene frames of each doubtful stretch of the current take."""
    take = current_take(scene)
    lane = read_lane(take) if take is not None else None
    if lane is None:
        return []
    frames, confidence = lane
    return [
        (round(frames[first]), round(frames[last])) for first, last in bad_ranges(confidence, scene.mocap.review.below)
    ]


CLASSES = (
    MOCAP_OT_next_bad_range, MOCAP_OT_pin_pose, MOCAP_OT_unpin, MOCAP_OT_show_take, MOCAP_OT_show_confidence,
    MOCAP_OT_select_body, MOCAP_OT_open_report, MOCAP_OT_view_camera, MOCAP_OT_leave_camera,
)  # fmt: skip
