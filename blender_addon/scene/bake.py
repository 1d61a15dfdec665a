"""Bake a motion and its capture into a scene, on a new body or as a new take of an existing one."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import bpy
import numpy as np

from .._exchange.capture_file import CaptureFile
from .._exchange.motion_file import MotionFile, read_motion
from .._exchange.progress import Progress, silent
from ..animation.action import bake_action
from ..animation.curves import current_action, curve_target, laid_rate, relay_take, same_rate
from ..animation.lanes import EDITS, FORGETS
from ..animation.layers import PLACE, without_layers
from ..animation.range_merge import RangeTimes, carry_curves, ends_used, merge_range
from ..animation.takes import BETAS, DIAGNOSTICS, PATHS, PERSON, found_in, mark_as_asset, show_take, take_file
from ..body.body_file import BodyFile, body_path_of, read_body, require_body, with_own_hands
from ..body.rig import create_rig
from ..conventions.coordinates import fit_units
from ..conventions.datablocks import KEYPOINT_COLOUR, child_collection
from ..conventions.naming import CLIP
from ..conventions.skeleton import layout_of
from ..conventions.timing import TakeTiming, scene_frame_rate, set_up_time, show_frame
from .cameras import look_through
from .capture_stage import create_cameras, create_detections, create_floor
from .hand_edits import played_channels, take_times
from .limb_modes import pose_from_ends
from .overlay import PointLook, create_point_overlay
from .props import create_props

_KEYPOINT_LOOK = PointLook(0.014, (KEYPOINT_COLOUR,))  # Radius in metres and colour. Chosen by hand.


@dataclass(frozen=True)
class BakeSettings:
    """Settings for baking a motion into a scene."""

    frame_start: int = 1  # Scene frame of the take's first frame.
    set_scene: bool = True
    """Set the scene's frame rate, range and camera. If False, keys are placed by time at the scene's frame rate."""
    scene_fps: float | None = None  # Frame rate for ``set_scene``, or None for the motion's rate.
    keys_per_second: float | None = None
    """Average number of keys to keep per second, connected by smooth curves. None writes a key at every frame."""
    tolerance_mm: float | None = None  # Keep as few keys as possible while every joint stays this close to the motion.
    asset: bool = False  # Mark the action as an asset.
    floor: bool = True  # Add a floor.
    backgrounds: bool = True  # Show footage behind the cameras.


@dataclass(frozen=True)
class BakedTake:
    """Blender objects, action and timing of a baked take."""

    collection: bpy.types.Collection
    body: bpy.types.Collection  # Collection that contains the armature and the mesh.
    armature: bpy.types.Object
    mesh: bpy.types.Object
    action: bpy.types.Action
    cameras: tuple[bpy.types.Object, ...]
    overlays: tuple[bpy.types.Object, ...]
    props: tuple[bpy.types.Object, ...]  # Empties. The mesh of each prop's markers is the child of its empty.
    floor: bpy.types.Object | None
    timing: TakeTiming
    notes: tuple[str, ...]  # Messages for the user, one sentence each.


def bake_take(
    scene: bpy.types.Scene,
    motion: MotionFile,
    body: BodyFile,
    capture: CaptureFile | None = None,
    settings: BakeSettings | None = None,
    parent: bpy.types.Collection | None = None,
) -> BakedTake:
    """Bake a motion and its capture into a new collection. The window must show the scene in object mode."""
    settings = settings or BakeSettings()
    require_body(motion, body)
    notes = _differences(motion, capture)
    if motion.body_layout.num_joints > body.layout.num_joints:
        notes.append("The body has no finger joints, so its hands stay at rest.")
    motion = with_own_hands(motion, body)
    start, fps = settings.frame_start, motion.fps
    scene_fps = (settings.scene_fps or fps) if settings.set_scene else None
    timing = set_up_time(scene, motion.num_frames, fps, start, scene_fps)
    take = child_collection(motion.name, parent or scene.collection)
    rest = body.rest_joints(motion.betas)
    figure = child_collection("Body", take)
    rig = create_rig(motion.name, body, motion.betas, figure)
    limits = settings.keys_per_second, settings.tolerance_mm
    action = bake_action(motion.name, motion, rig.armature, rest[0], timing, *limits)
    action[BETAS] = motion.betas.tolist()
    action[DIAGNOSTICS] = json.dumps(found_in(motion.provenance))
    notes += [action["keys_deviation"]] if "keys_deviation" in action else []
    if settings.asset:
        mark_as_asset(action)
    cameras, overlays = (), ()
    if capture is not None:
        cameras, missing = create_cameras(capture, take, timing, backgrounds=settings.backgrounds)
        notes += missing
        if settings.set_scene and cameras:
            look_through(scene, cameras[0])
        overlays = create_detections(capture, cameras, timing, child_collection("Detections", take), motion)
    if motion.keypoints3d is not None and motion.keypoints3d.size:
        folder, points = child_collection("Keypoints", take), motion.keypoints3d
        cloud = create_point_overlay("Triangulated keypoints", points, fps, timing, folder, _KEYPOINT_LOOK)
        overlays = (cloud, *overlays)
    props = create_props(scene, motion.props, fps, timing, take)
    floor = create_floor(rest[0] + motion.transl, child_collection("Floor", take)) if settings.floor else None
    fit_units(scene, (rig.armature, *cameras, *overlays, *((floor,) if floor is not None else ())))
    show_frame(scene, settings.frame_start if settings.set_scene else None)
    objects = rig.armature, rig.mesh, action, cameras, overlays, props, floor
    return BakedTake(take, figure, *objects, timing, tuple(notes))


def _differences(motion: MotionFile, capture: CaptureFile | None) -> list[str]:
    notes = []
    if not motion.body:
        notes.append("The motion does not name its body, so its shape is used for this body.")
    if capture is not None and capture.xy is not None:
        frames = capture.xy.shape[1]
        if frames != motion.num_frames:
            notes.append(f"The capture has {frames} frames and the motion {motion.num_frames}. Both start together.")
        if abs(capture.fps - motion.fps) > 1e-3:
            notes.append(f"The capture runs at {capture.fps:g} fps and the motion at {motion.fps:g}, aligned by time.")
    return notes


FEW = " reduced keys"  # Suffix of the name of each take that Reduce Keys creates.


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
    """Add a solved motion as a new action, to an existing body or to a new one.

    An existing ``armature`` gets the motion's shape. If the motion needs another body, a new armature is created in the
    collection ``parent``. Its name ends in ``suffix``, for instance the person's name.
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
    progress: Progress = silent,
) -> bpy.types.Action:
    """Add a copy of the current take with fewer keys (see ``bake_action`` for the limits), and play it."""
    motion = read_motion(take_file(take, "motion_file"))
    with without_layers(armature):
        edited = played_channels(scene, armature, take_times(take, motion), progress)
    name = f"{take.name.removesuffix(FEW)}{FEW}"
    return add_edited_take(scene, take, armature, name, edited, keys_per_second, tolerance_mm, progress)


def add_edited_take(
    scene: bpy.types.Scene,
    take: bpy.types.Action,
    armature: bpy.types.Object,
    name: str,
    edited: np.ndarray,
    keys_per_second: float | None = None,
    tolerance_mm: float | None = None,
    progress: Progress = silent,
) -> bpy.types.Action:
    """Add a take made from (F, 3 + 4 J) channels, with the files and person of another take, and play it."""
    motion = read_motion(take_file(take, "motion_file"))
    body = read_body(body_path_of(motion.provenance), motion.body_layout)
    require_body(motion, body)
    motion = with_own_hands(motion, body)
    timing = TakeTiming(int(take["frame_start"]), scene_frame_rate(scene))
    rest_pelvis = body.rest_joints(motion.betas)[0]
    limits = keys_per_second, tolerance_mm
    action = bake_action(name, motion, armature, rest_pelvis, timing, *limits, edited, progress)
    target = curve_target(action)
    assert target is not None, "a baked action has a slot"
    carry_curves(take, target, float(take["frame_start"]), timing.scene_fps / laid_rate(take))
    for key in (*PATHS, BETAS, PERSON, CLIP, EDITS, FORGETS):
        if key in take:
            action[key] = take[key]
    show_take(armature, action)
    show_frame(scene)
    return action


def keep_edits(
    scene: bpy.types.Scene,
    armature: bpy.types.Object,
    former: bpy.types.Action,
    solved: bpy.types.Action,
    first: int,
    last: int,
) -> bpy.types.Action:
    """Merge a new solve into a copy of an edited take, and play the result in place of the solved take.

    Frames from ``first`` to ``last`` come from ``solved``, and all other frames from ``former``.
    """
    rate, start = laid_rate(solved), float(solved["frame_start"])
    step = rate / float(solved["fps"])
    merged = former.copy()
    if not same_rate(laid_rate(former), rate):
        relay_take(merged, rate)
    times = RangeTimes(start + first * step, start + last * step, step)
    placed = ends_used(merged, times) if armature.animation_data.action == solved else []
    if placed:
        pose_from_ends(armature, scene, placed, start + step * np.arange(first, last + 1))
    merge_range(merged, solved, times, placed)
    for key in ("keys_deviation", "keys_deviation_mm", "keys_deviation_degrees"):
        merged.pop(key, None)
    for key, value in solved.items():
        if key != PLACE:
            merged[key] = value
    name = solved.name
    show_take(armature, merged)  # must precede the removal of the solved take, which it replaces below layers
    bpy.data.actions.remove(solved)
    merged.name, merged.use_fake_user = name, True
    return merged


def plays_body(armature: bpy.types.Object, motion: MotionFile, body: BodyFile) -> bool:
    """Return whether an armature can play a motion, including its fingers if the motion moves them."""
    action, layout = current_action(armature), layout_of(armature.data.bones)
    is_same = action is None or str(action.get("body", "")) in ("", motion.body)
    return is_same and layout.num_joints >= min(motion.body_layout.num_joints, body.layout.num_joints)
