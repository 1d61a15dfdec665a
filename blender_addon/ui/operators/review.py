"""Operators that review and correct a take: ranges, pins, contacts, confidence, feet, gaps and limbs."""

from __future__ import annotations

import math
from typing import Any

import bpy

from ..._exchange.errors import FileDamaged, FileMissing
from ..._exchange.marker_formats import is_report
from ...body.controls.limbs import LIMBS, limb_of
from ...conventions.naming import CLIP, ROOT_MOTION, counted
from ...errors import BodyUnreachable
from ..setting_properties import choice, number
from ..viewport import colour_bones
from .base import BODY, EDITABLE, OPENS, TAKE, Need, Steps, operator, works_here
from .takes import edit_aside

_MARGIN = 5  # Scene frames added on both sides of a range to review. The new solve must match the take there.
MARK = "gap"  # Start of the names of the add-on's timeline markers.
_GAP, _TO_REVIEW = f"{MARK} interpolated", f"{MARK} review"
_SAMPLES = 16
"""Number of frames that Feet to Floor measures. Chosen by hand."""
_NOTHING_MEASURED = 1e-6  # Largest confidence (0 to 1) that an interpolated frame can have.


@operator("Next Range to Review", TAKE, backwards=bool)
def next_bad_range(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Go to the next frame range to review, and make it the range to solve again."""
    from ...review.ranges import doubtful_ranges, next_range

    scene, review = context.scene, context.scene.mocap.review
    ranges = doubtful_ranges(review.take, review.below)
    found = next_range(ranges, scene.frame_current, backwards=self.backwards)
    if found is None:
        return self.give_up("No frame is below the threshold", "INFO")
    first, last = review.take.frame_range
    review.first = max(found[0] - _MARGIN, math.floor(first))
    review.last = min(found[1] + _MARGIN, math.ceil(last))
    scene.frame_set(found[0])
    return f"Frames {found[0]} to {found[1]}, {ranges.index(found) + 1} of {len(ranges)}"


@operator("Add Face", BODY, EDITABLE)
def add_face(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Give the body shape keys with ARKit's 52 names, and bones for jaw, eyes and upper lids."""
    from ...body.body_file import body_path_of, read_body
    from ...body.face import add_face_bones, add_face_shapes
    from ...body.looks import show_look
    from ...body.shape import body_mesh
    from ...conventions.skeleton import layout_of
    from ...scene.session import undisturbed

    review = context.scene.mocap.review
    mesh, provenance = body_mesh(review.armature), review.take.get("provenance", "") if review.take else ""
    body = read_body(body_path_of(provenance), layout_of(review.armature.data.bones))
    if mesh is None or not body.face_shapes:
        return self.give_up("Only the body that ships with the add-on has face shapes")
    if not (mesh.data.is_editable and review.armature.data.is_editable):
        return self.give_up("This body is linked. Add the face in its own file")
    if review.armature.hide_viewport or review.armature.name not in context.view_layer.objects:
        return self.give_up(
            "The armature is disabled in viewports. Enable it and its collection, and add the face again"
        )
    count = add_face_shapes(mesh, body)
    with undisturbed(context):
        bones = add_face_bones(review.armature, mesh, body)
    show_look(mesh, context.scene.mocap.look)
    return f"{counted(count, 'face shape')} and {counted(bones, 'face bone')} added to '{mesh.name}'"


@operator("Pin Current Pose", TAKE)
def pin_pose(self: Any, context: bpy.types.Context) -> str:
    """Keep the pose of this frame, with your edits, when the range is solved again."""
    review, frame = context.scene.mocap.review, context.scene.frame_current
    pin_frame(review, frame)
    review.first, review.last = min(review.first, frame), max(review.last, frame)
    return f"Frame {frame} is pinned"


def pin_frame(review: bpy.types.PropertyGroup, frame: int) -> None:
    """Store the body's current pose as a pin that a new solve of the range must keep."""
    from ...review.ranges import pinned_values

    values = pinned_values(review.armature)
    pin = next((pin for pin in review.pins if pin.frame == frame), None) or review.pins.add()
    pin.frame, pin.subframe, pin.job_values = frame, 0.0, values


@operator("Unpin", first=int, last=int)
def unpin(self: Any, context: bpy.types.Context) -> None:
    """Let the solver change these poses again."""
    pins = context.scene.mocap.review.pins
    for index in reversed(range(len(pins))):
        if self.first <= pins[index].frame <= self.last:
            pins.remove(index)


_PINS = Need("Nothing is pinned", lambda context: len(context.scene.mocap.review.pins))


@operator("Clear Pins", _PINS)
def clear_pins(self: Any, context: bpy.types.Context) -> None:
    """Let the solver change all pinned poses again."""
    context.scene.mocap.review.pins.clear()


def _edit_contact(self: Any, context: bpy.types.Context, *, touches: bool) -> str | set[str]:
    from ..._exchange.contact_parts import part_of_joint
    from ...animation.curves import curve_target
    from ...animation.lanes import edit_contact
    from ...review.ranges import capture_range

    review = context.scene.mocap.review
    bone = review.armature.data.bones.active
    part = part_of_joint(bone.name) if bone is not None else None
    target = curve_target(review.take) if review.take.is_editable else None
    if target is None:
        return self.give_up("This take is linked. Make it local first")
    if part is None:
        return self.give_up("Select a bone of the body in Pose Mode, such as a knee or a hand")
    ends = review.first, review.last
    edit = [part, *capture_range(review.take, *ends), touches]
    edit_contact(target, review.armature, part, ends, edit)
    state = "touches the floor" if touches else "does not touch the floor"
    return f"{part.replace('_', ' ').capitalize()} {state} in frames {ends[0]} to {ends[1]}. Press Solve Range Again"


@operator("Add Contact", TAKE, EDITABLE)
def add_contact(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Keep the active bone's body part on the floor from First to Last when the range is solved again."""
    return _edit_contact(self, context, touches=True)


@operator("Remove Contact", TAKE, EDITABLE)
def remove_contact(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Let the active bone's body part move from First to Last when the range is solved again."""
    return _edit_contact(self, context, touches=False)


def _has_contact_edits(context: bpy.types.Context) -> bool:
    from ...animation.lanes import has_contact_edits

    return has_contact_edits(context.scene.mocap.review.take)


_CONTACTS = Need("No contact is edited", _has_contact_edits)


@operator("Clear Contact Edits", TAKE, _CONTACTS)
def clear_contacts(self: Any, context: bpy.types.Context) -> str:
    """Clear the contacts that you added or removed in this take."""
    from ...animation.lanes import clear_contact_edits

    clear_contact_edits(context.scene.mocap.review.take)
    return "Press Solve Range Again to detect the contacts from First to Last"


@operator("Show Confidence", TAKE, EDITABLE)
def show_confidence(self: Any, context: bpy.types.Context) -> None:
    """Colour bones and skin by confidence, and mark the frames to review on the timeline."""
    review = context.scene.mocap.review
    review.colours = not review.colours
    colour_bones(context.scene)


@operator("Select Body", BODY)
def select_body(self: Any, context: bpy.types.Context) -> None:
    """Leave pose mode and select only the solved body."""
    _select_alone(context, context.scene.mocap.review.armature)


def start_cube(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the cube in Blender's start-up scene if it is visible and has not been moved, or None."""
    cube = scene.objects.get("Cube")
    if cube is None or cube.type != "MESH" or cube.animation_data or cube.location.length or not cube.visible_get():
        return None
    return cube if len(cube.data.vertices) == 8 else None


_CUBE = Need("There is no start-up cube", lambda context: start_cube(context.scene))


@operator("Hide Cube", _CUBE)
def hide_cube(self: Any, context: bpy.types.Context) -> None:
    """Hide Blender's default cube, which may enclose the body, but keep it in the file."""
    if (cube := start_cube(context.scene)) is not None:
        cube.hide_set(True)
        cube.hide_render = True


@operator("Open Report", TAKE, options=OPENS)
def open_report(self: Any, context: bpy.types.Context) -> set[str]:
    """Open the page with this take's errors, warnings and charts."""
    from ...animation.takes import take_file

    take = context.scene.mocap.review.take
    path = take_file(take, "report_file")
    if not path.is_file():
        hint = "Solve again with Report enabled under Advanced."
        raise FileMissing("This take has no report.", where=str(path), hint=hint)
    if not is_report(path, take_file(take, "motion_file").parent):
        hint = "Solve again with Report enabled, or open it yourself if you trust it."
        message = "This file is not a solver report, so it was not opened."
        raise FileDamaged(message, where=str(path), hint=hint)
    self.tell(f"Report: {path}")
    return bpy.ops.wm.path_open(filepath=str(path))


def _select_alone(context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Switch to object mode, then unhide and select only this object. Raise an error if its collection is hidden."""
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


@operator("Feet to Floor", TAKE, EDITABLE)
def feet_to_floor(self: Any, context: bpy.types.Context) -> str | set[str]:
    """Set Floor Offset so that the lowest point of the body is on the floor (median over the take)."""
    from ...review.ranges import sole_height

    review = context.scene.mocap.review
    height = sole_height(context.scene, review.armature, review.take, _SAMPLES)
    if height is None:
        return self.give_up("The body has no skin")
    review.floor_offset -= height
    moved_mm = 1000.0 * context.scene.unit_settings.scale_length * abs(height)
    return f"The body was {'lowered' if height > 0 else 'raised'} by {moved_mm:.0f} mm"


_FOREIGN = Need(
    "This take is solved from a capture. Raise Foot Lock and press Solve Again",
    lambda context: not context.scene.mocap.capture.file or CLIP in (context.scene.mocap.review.take or ()),
)
_ON_BODY = Need(
    "This take is on the root control. Show its source take",
    lambda context: ROOT_MOTION not in context.scene.mocap.review.take,
)
_SLIDE = number(
    "Longest Slide", "Largest slide to correct in mm (longer slides are treated as intentional)", 100.0, 1, 500
)
"""Largest slide of a planted foot that is corrected, in millimetres."""


@operator("Lock Feet", _FOREIGN, TAKE, _ON_BODY, EDITABLE, waits=False, slide_mm=_SLIDE)
def lock_feet(self: Any, context: bpy.types.Context) -> Steps:
    """Add a take that includes your edits but no foot sliding (for clips from other programs)."""
    from ...retarget.locked_feet import lock_feet

    review = context.scene.mocap.review
    if works_here([review.armature], review.take["frames"]):
        made = lock_feet(context.scene, review.take, review.armature, self.slide_mm)
        name, stands, slid_mm = ("", 0, 0.0) if made is None else (made.action.name, made.stands, made.slid_mm)
    else:
        made = yield from edit_aside(context, lock_feet=self.slide_mm)
        name = made["action"] and made["action"].name
        stands, slid_mm = made.get("stands", 0), made.get("slid_mm", 0.0)
    if not name:
        return self.give_up(f"Every planted foot slides by more than {self.slide_mm:g} mm, so nothing was locked")
    return f"{counted(stands, 'foot contact')} locked in '{name}': feet slid by up to {slid_mm:.0f} mm"


@operator("Mark Gaps", TAKE)
def mark_gaps(self: Any, context: bpy.types.Context) -> str:
    """Add timeline markers where frames are interpolated or need review, and remove outdated ones."""
    from ...review.ranges import doubtful_ranges

    scene, review = context.scene, context.scene.mocap.review
    _remove_marks(scene)
    gaps = doubtful_ranges(review.take, _NOTHING_MEASURED)
    others = [r for r in doubtful_ranges(review.take, review.below) if not any(_meet(r, gap) for gap in gaps)]
    for name, ranges in ((_GAP, gaps), (_TO_REVIEW, others)):
        for first, last in ranges:
            scene.timeline_markers.new(f"{name} {first}-{last}", frame=first)
    return f"{counted(len(gaps), 'interpolated range')}, {counted(len(others), 'range')} to review"


@operator("Clear Gap Markers")
def clear_marks(self: Any, context: bpy.types.Context) -> None:
    """Remove the add-on's gap markers from the timeline, and keep your own markers."""
    _remove_marks(context.scene)


def _remove_marks(scene: bpy.types.Scene) -> None:
    for marker in [m for m in scene.timeline_markers if m.name.startswith((f"{_GAP} ", f"{_TO_REVIEW} "))]:
        scene.timeline_markers.remove(marker)


def _meet(a: tuple[int, int], b: tuple[int, int]) -> bool:
    return a[0] <= b[1] and b[0] <= a[1]


_TO = choice("To", "Controls used to animate the limbs from now on", "switch_limbs.to")
_LIMB = choice("Limb", "Switch all limbs, or a single arm or leg", "switch_limbs.limb")


@operator("Switch Limbs", BODY, EDITABLE, waits=False, to=_TO, limb=_LIMB)
def switch_limbs(self: Any, context: bpy.types.Context) -> Steps:
    """Switch limbs between IK and FK with keys that keep the motion."""
    from ...scene.limb_modes import switch_limbs

    review, limbs = context.scene.mocap.review, LIMBS if self.limb == "ALL" else (limb_of(self.limb),)
    armature, take = review.armature, review.take
    plays = take is not None and armature.animation_data.action == take and take.is_editable
    if not plays or works_here([armature], take["frames"]):
        frames = switch_limbs(armature, context.scene, self.to, limbs)
    else:
        made = yield from edit_aside(context, switch=[self.to, *(limb.switch for limb in limbs)])
        if made["action"] is None:
            return self.give_up("The take was edited while its limbs were switched. Try again")
        frames = made["frames"]
    return f"{self.to}: {counted(frames, 'frame')} keyed" if frames else f"{self.to}: the pose is set"
