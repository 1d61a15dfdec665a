"""Bake a motion and its capture: body, action, cameras, detections, floor."""

from __future__ import annotations

import json
from dataclasses import dataclass

import bpy

from .._exchange.capture_file import CaptureFile
from .._exchange.motion_file import MotionFile
from ..animation.action import bake_action
from ..animation.takes import BETAS, DIAGNOSTICS, found_in, mark_as_asset
from ..body.body_choice import require_body
from ..body.body_file import BodyFile
from ..body.posed_body import with_own_hands
from ..body.rig import create_rig
from ..conventions.coordinates import fit_units
from ..conventions.datablocks import KEYPOINT_COLOUR, child_collection
from ..conventions.timing import TakeTiming, set_up_time, show_frame
from .cameras import look_through
from .capture_stage import create_cameras, create_detections, create_floor
from .overlay import PointLook, create_point_overlay
from .props import create_props

_KEYPOINT_LOOK = PointLook(0.014, (KEYPOINT_COLOUR,))
"""Radius in metres, and colour, chosen by hand."""


@dataclass(frozen=True)
class BakeSettings:
    """Settings of a bake."""

    frame_start: int = 1
    """Scene frame of the take's first frame."""
    set_scene: bool = True
    """Set the scene's frame rate, range and camera. Otherwise keys are placed by time at the scene's own rate."""
    scene_fps: float | None = None
    """Frame rate for ``set_scene``, None for the motion's own."""
    keys_per_second: float | None = None
    """Average number of the solver's keys to keep, joined by smooth curves. None writes a key on every frame."""
    tolerance_mm: float | None = None
    """Keep as few keys as possible with every joint within this tolerance."""
    asset: bool = False
    """Mark the action as an asset."""
    floor: bool = True
    """Add a floor."""
    backgrounds: bool = True
    """Show footage behind the cameras."""


@dataclass(frozen=True)
class BakedTake:
    """The objects of one take."""

    collection: bpy.types.Collection
    body: bpy.types.Collection
    """Collection of the armature and the mesh."""
    armature: bpy.types.Object
    mesh: bpy.types.Object
    action: bpy.types.Action
    cameras: tuple[bpy.types.Object, ...]
    overlays: tuple[bpy.types.Object, ...]
    props: tuple[bpy.types.Object, ...]
    """Empties, each with the mesh of its markers as its child."""
    floor: bpy.types.Object | None
    timing: TakeTiming
    notes: tuple[str, ...]
    """Findings, one sentence each."""


def bake_take(
    scene: bpy.types.Scene,
    motion: MotionFile,
    body: BodyFile,
    capture: CaptureFile | None = None,
    settings: BakeSettings | None = None,
    parent: bpy.types.Collection | None = None,
) -> BakedTake:
    """Bake a motion and its capture into a new collection of a scene, in ``parent`` if given. Nothing else changes.

    Blender must be in object mode, and the scene the window's current one.

    Raises:
        BodyMismatch: the motion states that it belongs to another body.
    """
    settings = settings or BakeSettings()
    require_body(motion, body)
    notes = _differences(motion, capture)
    if motion.body_layout.num_joints > body.layout.num_joints:
        notes.append("The body has no finger joints: its hands rest.")
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
        notes.append("The motion does not name its body: its shape is read as this body's.")
    if capture is not None and capture.xy is not None:
        frames = capture.xy.shape[1]
        if frames != motion.num_frames:
            notes.append(f"The capture has {frames} frames and the motion {motion.num_frames}; both start together.")
        if abs(capture.fps - motion.fps) > 1e-3:
            notes.append(f"The capture runs at {capture.fps:g} fps and the motion at {motion.fps:g}; aligned by time.")
    return notes
