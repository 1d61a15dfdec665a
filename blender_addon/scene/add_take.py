"""A take added to a scene: each solve is a new action of a body, and earlier ones stay."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from .._exchange.motion_file import MotionFile, read_motion
from ..animation.action import bake_action
from ..animation.curves import current_action, curve_target, laid_rate, relay_take, same_rate
from ..animation.layers import PLACE, without_layers
from ..animation.range_merge import RangeTimes, carry_curves, merge_range
from ..animation.takes import BETAS, PATHS, PERSON, show_take, take_file
from ..body.body_choice import body_path_of, require_body
from ..body.body_file import BodyFile, read_body
from ..body.posed_body import with_own_hands
from ..conventions.skeleton import layout_of
from ..conventions.timing import TakeTiming, scene_frame_rate, show_frame
from .bake import BakeSettings, bake_take
from .hand_edits import played_channels, take_times
from .props import create_props

FEW = " few keys"
"""Suffix of the names of takes with few keys."""


def add_take(
    scene: bpy.types.Scene,
    name: str,
    motion: MotionFile,
    body: BodyFile,
    armature: bpy.types.Object | None,
    parent: bpy.types.Collection | None,
    frame_start: int,
    suffix: str = "",
) -> tuple[bpy.types.Object, bpy.types.Action]:
    """Add a solved motion as a new action, to the existing body or with a new one.

    Args:
        scene: the scene, which keeps its frame rate.
        name: name of the take.
        motion: the motion.
        body: the body it was solved for.
        armature: the body of earlier takes, which gets the motion's shape, None if there is none. A motion of another
            body gets its own armature.
        parent: collection of a new body, None for the scene's.
        frame_start: scene frame of the first frame.
        suffix: suffix of a new body's name, such as the person.

    Returns:
        The armature and the action, which it plays.

    Raises:
        BodyMismatch: the motion belongs to another body.
    """
    require_body(motion, body)
    motion = with_own_hands(motion, body)
    if armature is not None and (not armature.is_editable or not plays_body(armature, motion, body)):
        armature = None
    if armature is None:
        settings = BakeSettings(frame_start=frame_start, set_scene=False, floor=False)
        body_name = name if parent is None else f"{parent.name}{suffix}"
        take = bake_take(scene, replace(motion, name=body_name), body, None, settings, parent)
        armature, action = take.armature, take.action
        action.name = name
    else:
        timing = TakeTiming(frame_start, scene_frame_rate(scene))
        action = bake_action(name, motion, armature, body.rest_joints(motion.betas)[0], timing)
        create_props(scene, motion.props, motion.fps, timing, armature.users_collection[0])
    action[BETAS] = motion.betas.tolist()
    show_take(armature, action)
    show_frame(scene)
    return armature, action


def thinned_take(
    scene: bpy.types.Scene,
    take: bpy.types.Action,
    armature: bpy.types.Object,
    keys_per_second: float | None,
    tolerance_mm: float | None = None,
) -> bpy.types.Action:
    """Add a take of smooth curves with few keys, made of the take as it plays with all hand edits, and play it.

    See ``bake_action`` for the limits. A motion or body that cannot be read is a ``MocapError``.
    """
    motion = read_motion(take_file(take, "motion_file"))
    with without_layers(armature):
        edited = played_channels(scene, armature, take_times(take, motion))
    name = f"{take.name.removesuffix(FEW)}{FEW}"
    return add_edited_take(scene, take, armature, name, edited, keys_per_second, tolerance_mm)


def add_edited_take(
    scene: bpy.types.Scene,
    take: bpy.types.Action,
    armature: bpy.types.Object,
    name: str,
    edited: np.ndarray,
    keys_per_second: float | None = None,
    tolerance_mm: float | None = None,
) -> bpy.types.Action:
    """Add a take made of another one, with its files and its person, and play it.

    Args:
        scene: the scene.
        take: the other take.
        armature: the body.
        name: name of the new take.
        edited: (F, 3 + 4 J) channels, see ``pose_channels``.
        keys_per_second: see ``bake_action``.
        tolerance_mm: see ``bake_action``.
    """
    motion = read_motion(take_file(take, "motion_file"))
    body = read_body(body_path_of(motion.provenance), motion.body_layout)
    require_body(motion, body)
    motion = with_own_hands(motion, body)
    timing = TakeTiming(int(take["frame_start"]), scene_frame_rate(scene))
    rest_pelvis = body.rest_joints(motion.betas)[0]
    action = bake_action(name, motion, armature, rest_pelvis, timing, keys_per_second, tolerance_mm, edited)
    target = curve_target(action)
    assert target is not None, "a baked action has a slot"
    carry_curves(take, target, float(take["frame_start"]), timing.scene_fps / laid_rate(take))
    for key in (*PATHS, BETAS, PERSON):
        if key in take:
            action[key] = take[key]
    show_take(armature, action)
    show_frame(scene)
    return action


def keep_edits(
    armature: bpy.types.Object, former: bpy.types.Action, solved: bpy.types.Action, first: int, last: int
) -> bpy.types.Action:
    """Return a take with frames first to last (from 0) as solved and all others as edited, and play it.

    Args:
        armature: the body.
        former: the edited take, which stays.
        solved: the solved motion over all frames, which is removed.
        first: first frame of the range.
        last: last frame of the range.
    """
    rate, start = laid_rate(solved), float(solved["frame_start"])
    step = rate / float(solved["fps"])
    merged = former.copy()
    if not same_rate(laid_rate(former), rate):
        relay_take(merged, rate)
    merge_range(merged, solved, RangeTimes(start + first * step, start + last * step, step))
    for key in ("keys_deviation", "keys_deviation_mm", "keys_deviation_degrees"):
        merged.pop(key, None)
    for key, value in solved.items():
        if key != PLACE:
            merged[key] = value
    name = solved.name
    show_take(armature, merged)  # before the solved one is removed, which it replaces below layers
    bpy.data.actions.remove(solved)
    merged.name, merged.use_fake_user = name, True
    return merged


def plays_body(armature: bpy.types.Object, motion: MotionFile, body: BodyFile) -> bool:
    """Return whether an armature can play a motion: it plays the same body, and has fingers if they move."""
    action, layout = current_action(armature), layout_of(armature.data.bones)
    is_same = action is None or str(action.get("body", "")) in ("", motion.body)
    return is_same and layout.num_joints >= min(motion.body_layout.num_joints, body.layout.num_joints)
