"""Operators that save edited copies of a take (clips), and that mark takes and poses as assets."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from ...conventions.naming import counted
from ...errors import RenderFailed
from ..project_files import bring_home
from ..setting_properties import number, switch
from .base import BODY, EDITABLE, TAKE, Need, operator
from .takes import take_named

if TYPE_CHECKING:
    from ..._exchange.motion_file import MotionFile

_UNDO = {"UNDO"}  # no Adjust Last Operation panel, because each run writes a file


def ask(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    """Ask for an operator's properties in a dialog."""
    return context.window_manager.invoke_props_dialog(self)


def _is_alone(context: bpy.types.Context) -> bool:
    from ...animation.layers import has_layers

    return not has_layers(context.scene.mocap.review.armature)


ALONE = Need("A layer plays on top of this take. Bake it into the take, or push it down and mute it first", _is_alone)


def _add(context: bpy.types.Context, word: str, edit: Any, *, with_place: bool = False) -> str:
    """Add an edited copy of the current take, and return a message with its name and length."""
    from ...scene.clips import add_clip

    review = context.scene.mocap.review
    action = add_clip(context.scene, review.armature, review.take, word, edit, with_place=with_place)
    bring_home()
    return f"'{action.name}' has {counted(int(action['frames']), 'frame')}"


def _ask_range(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    review = context.scene.mocap.review
    self.first, self.last = review.first, review.last
    return ask(self, context, event)


_FIRST = number("First", "First scene frame to keep", 1, -1048574, 1048574)
"""First scene frame to keep. The limits are Blender's smallest and largest frame."""
_LAST = number("Last", "Last scene frame to keep", 250, -1048574, 1048574)
"""Last scene frame to keep. The limits are Blender's smallest and largest frame."""


@operator("Trim", TAKE, EDITABLE, ALONE, options=_UNDO, invoke=_ask_range, first=_FIRST, last=_LAST)
def trim_take(self: Any, context: bpy.types.Context) -> str:
    """Add a take that contains only the scene frames from First to Last."""
    from ..._exchange.clips import trim

    first, last = range_of_take(context.scene.mocap.review.take, self)
    return _add(context, "trim", lambda motion: trim(motion, first, last))


def range_of_take(take: bpy.types.Action, scene_range: Any) -> tuple[int, int]:
    """Convert a range of scene frames to the first and last frame of a take, counted from 0.

    Raises:
        MotionInvalid: the take has no frame in the range.
    """
    from ..._exchange.errors import MotionInvalid
    from ...animation.curves import laid_rate

    step, start = float(take["fps"]) / laid_rate(take), float(take["frame_start"])
    first, last = (round((frame - start) * step) for frame in (scene_range.first, scene_range.last))
    if first > last or last < 0 or first >= take["frames"]:
        what = f"The take has no frames {scene_range.first} to {scene_range.last}."
        hint = f"It plays from frame {start:g} to {start + (take['frames'] - 1) / step:g}."
        raise MotionInvalid(what, where=take.name, hint=hint)
    return max(first, 0), min(last, take["frames"] - 1)


_SHORTEST = number("Shortest Cycle", "Reject cycles that are shorter than this, in seconds", 0.4, 0.1, 60)
"""Shortest cycle in seconds (see ``seams.SHORTEST_S``)."""
_STAY = switch("In Place", "Remove the cycle's travel and turning")


@operator("Loop", TAKE, EDITABLE, ALONE, options=_UNDO, invoke=ask, shortest_s=_SHORTEST, in_place=_STAY)
def loop_take(self: Any, context: bpy.types.Context) -> str:
    """Add the best cycle of this take as a new take that loops."""
    from ..._exchange.seams import find_loop

    found: list[Any] = []

    def edit(motion: MotionFile) -> MotionFile:
        found.append(find_loop(motion, self.shortest_s, stay=self.in_place))
        return found[0].motion

    message = _add(context, "loop", edit)
    return f"{message}. At its ends, {found[0].gap}. The difference is blended"


@operator("Mirror", TAKE, EDITABLE, ALONE, options=_UNDO)
def mirror_take(self: Any, context: bpy.types.Context) -> str:
    """Add a take with left and right swapped, starting at the same place and in the same direction."""
    from ..._exchange.clips import mirror

    return _add(context, "mirror", mirror)


def _draw_other(self: Any, context: bpy.types.Context) -> None:
    self.layout.prop_search(self, "name", bpy.data, "actions", text="Then")
    self.layout.prop(self, "blend_s")


_BLEND = number("Blend Time", "Blend duration on each side of the seam, in seconds", 0.25, 0, 5)
"""Blend time in seconds (see ``seams.BLEND_S``)."""


@operator("Join", TAKE, EDITABLE, ALONE, options=_UNDO, invoke=ask, draw=_draw_other, name=str, blend_s=_BLEND)
def join_takes(self: Any, context: bpy.types.Context) -> str:
    """Add a take that joins this take and another take of the body, aligned by the planted feet."""
    from ..._exchange.seams import join, join_notes
    from ...animation.takes import show_take
    from ...scene.clips import played_motion

    scene, review = context.scene, context.scene.mocap.review
    take, other = review.take, take_named(scene.mocap, self.name)
    show_take(review.armature, other)
    try:
        second = played_motion(scene, review.armature, other)
    finally:
        show_take(review.armature, take)
    notes: list[str] = []

    def edit(motion: MotionFile) -> MotionFile:
        notes.extend(join_notes(motion, second))
        return join(motion, second, self.blend_s)[0]

    return ". ".join([_add(context, "join", edit), *notes])


_SPEED = number("Speed", "Speed factor, such as 2 for twice as fast", 1.0, 0.05, 20)
"""Speed factor. Limits chosen by hand."""


@operator("Retime", TAKE, EDITABLE, ALONE, options=_UNDO, invoke=ask, speed=_SPEED)
def retime_take(self: Any, context: bpy.types.Context) -> str:
    """Add a take that plays faster or slower."""
    from ..._exchange.clips import retime

    return _add(context, "retime", lambda motion: retime(motion, self.speed))


def _ask_rate(self: Any, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
    from ...conventions.timing import scene_frame_rate

    self.fps = scene_frame_rate(context.scene)
    return ask(self, context, event)


_FPS = number("Frame Rate", "Frames per second of the new take", 30.0, 1, 1000)
"""Frame rate in frames per second. Limits chosen by hand."""


@operator("Resample", TAKE, EDITABLE, ALONE, options=_UNDO, invoke=_ask_rate, fps=_FPS)
def resample_take(self: Any, context: bpy.types.Context) -> str:
    """Add a take at the same speed with a different frame rate."""
    from ..._exchange.clips import resample

    return _add(context, "resample", lambda motion: resample(motion, self.fps))


@operator("In Place", TAKE, EDITABLE, ALONE, options=_UNDO)
def place_take(self: Any, context: bpy.types.Context) -> str:
    """Add a take without the travel over the ground, such as a walk cycle on the spot."""
    from ..._exchange.clips import in_place

    return _add(context, "in place", in_place)


@operator("Root Motion", TAKE, EDITABLE, ALONE, options=_UNDO)
def root_take(self: Any, context: bpy.types.Context) -> str:
    """Add a take that stores travel and heading on the root control, as game engines expect."""
    from ..._exchange.clips import root_motion

    return _add(context, "root motion", root_motion, with_place=True)


@operator("Mark as Asset", TAKE)
def mark_take(self: Any, context: bpy.types.Context) -> str:
    """Add this take to the asset browser, with its length, frame rate and a preview image of this frame."""
    from ...animation.takes import mark_as_asset
    from ...render.asset import TAKES

    take = context.scene.mocap.review.take
    mark_as_asset(take)
    return _file_asset(self, context, take, TAKES)


@operator("Mark Pose as Asset", BODY)
def mark_pose(self: Any, context: bpy.types.Context) -> str:
    """Add the body's current pose to the asset browser, with a preview image."""
    from ...render.asset import POSES
    from ...scene.clips import add_pose

    return _file_asset(self, context, add_pose(context.scene, context.scene.mocap.review.armature), POSES)


def _file_asset(self: Any, context: bpy.types.Context, action: bpy.types.Action, catalog: tuple[str, str]) -> str:
    """Render an asset's preview, add the asset to a catalog, and return a message."""
    from ...body.shape import body_mesh
    from ...render.asset import add_catalog, show_preview

    armature = context.scene.mocap.review.armature
    if (mesh := body_mesh(armature)) is not None:
        try:
            show_preview(action, mesh, (armature, mesh))
        except RenderFailed as error:
            self.tell(str(error), kind="WARNING")
    if not bpy.data.filepath:
        return f"'{action.name}' is an asset of this file. Save the file to put assets in a catalog"
    action.asset_data.catalog_id = add_catalog(Path(bpy.data.filepath).parent, catalog)
    return f"'{action.name}' is an asset in the catalog {catalog[1]}"
