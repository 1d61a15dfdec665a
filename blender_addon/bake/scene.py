"""The bake as a pipeline of verbs: body, action, cameras, detections, floor."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..errors import BodyMismatch
from ..files.body_file import BodyFile
from ..files.capture_file import CameraFile, CaptureFile
from ..files.motion_file import MotionFile
from .action import bake_action
from .armature import create_armature
from .cameras import add_background, create_camera, look_through
from .floor import create_floor
from .materials import DETECTION_COLOUR, KEYPOINT_COLOUR, MARKER_COLOUR
from .mesh import create_body_mesh
from .overlay import create_point_overlay, create_view_overlay
from .timing import TakeTiming, scene_frame_rate, set_scene_frame_rate


@dataclass(frozen=True)
class BakeSettings:
    """What a bake makes."""

    frame_start: int = 1
    """Scene frame of the take's first frame."""
    set_scene: bool = True
    """Set the scene's frame rate, range and camera; otherwise keys are placed by time at the scene's own rate."""
    preserve_volume: bool = False
    """Deform by dual quaternions instead of linear blend skinning."""
    floor: bool = True
    """Add a floor."""
    backgrounds: bool = True
    """Show footage behind the cameras where there is any."""


@dataclass(frozen=True)
class BakedTake:
    """The objects of one take."""

    collection: bpy.types.Collection
    """Holds everything of the take."""
    body: bpy.types.Collection
    """Holds the armature and the mesh."""
    armature: bpy.types.Object
    mesh: bpy.types.Object
    action: bpy.types.Action
    cameras: tuple[bpy.types.Object, ...]
    overlays: tuple[bpy.types.Object, ...]
    floor: bpy.types.Object | None
    timing: TakeTiming
    notes: tuple[str, ...]
    """What was missing or assumed, one sentence each."""


def bake_take(
    scene: bpy.types.Scene,
    motion: MotionFile,
    body: BodyFile,
    capture: CaptureFile | None = None,
    settings: BakeSettings | None = None,
) -> BakedTake:
    """Bake a motion, and the capture it was solved from, into a scene; nothing that is there is changed.

    Blender must be in object mode, and the scene the window's current one.

    Raises:
        BodyMismatch: the motion says that it belongs to another body.
    """
    settings = settings or BakeSettings()
    require_body(motion, body)
    notes = _differences(motion, capture)
    timing = _set_time(scene, motion, settings)
    take = _collection(motion.name, scene.collection)
    rest = body.rest_joints(motion.betas)
    figure = _collection("Body", take)
    armature = create_armature(motion.name, body, motion.betas, figure)
    mesh = create_body_mesh(
        f"{motion.name} body", body, motion.betas, armature, preserve_volume=settings.preserve_volume
    )
    action = bake_action(motion.name, motion, armature, rest[0], timing)
    cameras = _bake_cameras(scene, capture, take, settings, notes)
    overlays = _bake_overlays(motion, capture, cameras, timing, take)
    floor = None
    if settings.floor:
        floor = create_floor(rest[0] + motion.transl, _collection("Floor", take))
    scene.frame_set(settings.frame_start)
    return BakedTake(take, figure, armature, mesh, action, cameras, overlays, floor, timing, tuple(notes))


def require_body(motion: MotionFile, body: BodyFile) -> None:
    """Check that a motion belongs to a body; a motion that does not say so fits any.

    Raises:
        BodyMismatch: both have an id and the ids differ.
    """
    if motion.body and body.id and motion.body != body.id:
        raise BodyMismatch(
            f"The motion was solved for the body '{motion.body}', not for '{body.id}'.",
            where=motion.name,
            hint="Name the body file it was solved for.",
        )


def _differences(motion: MotionFile, capture: CaptureFile | None) -> list[str]:
    notes = []
    if not motion.body:
        notes.append("The motion does not say which body it is for: its shape is read as this body's.")
    if capture is not None and capture.xy is not None:
        frames = capture.xy.shape[1]
        if frames != motion.num_frames:
            notes.append(f"The capture has {frames} frames and the motion {motion.num_frames}; both start together.")
        if abs(capture.fps - motion.fps) > 1e-3:
            notes.append(f"The capture runs at {capture.fps:g} fps and the motion at {motion.fps:g}; aligned by time.")
    return notes


def _set_time(scene: bpy.types.Scene, motion: MotionFile, settings: BakeSettings) -> TakeTiming:
    if settings.set_scene:
        set_scene_frame_rate(scene, motion.fps)
        timing = TakeTiming(settings.frame_start, motion.fps)
        scene.frame_start = settings.frame_start
        scene.frame_end = timing.last_frame(motion.num_frames, motion.fps)
        return timing
    return TakeTiming(settings.frame_start, scene_frame_rate(scene))


def _collection(name: str, parent: bpy.types.Collection) -> bpy.types.Collection:
    collection = bpy.data.collections.new(name)
    parent.children.link(collection)
    return collection


def _bake_cameras(
    scene: bpy.types.Scene,
    capture: CaptureFile | None,
    take: bpy.types.Collection,
    settings: BakeSettings,
    notes: list[str],
) -> tuple[bpy.types.Object, ...]:
    if capture is None or not capture.cameras:
        return ()
    folder = _collection("Cameras", take)
    cameras = tuple(create_camera(source, folder) for source in capture.cameras)
    for camera, source in zip(cameras, capture.cameras, strict=True):
        notes.extend(_lens_notes(source))
        if settings.backgrounds:
            note = add_background(camera, source, frame_start=settings.frame_start)
            notes.extend([note] if note else [])
    if settings.set_scene:
        look_through(scene, cameras[0])
    return cameras


def _lens_notes(source: CameraFile) -> list[str]:
    skew = abs(source.K[0, 1])
    return [f"Camera {source.name}: its skew of {skew:.2g} px is left out."] if skew > 0.01 else []


def _bake_overlays(
    motion: MotionFile,
    capture: CaptureFile | None,
    cameras: tuple[bpy.types.Object, ...],
    timing: TakeTiming,
    take: bpy.types.Collection,
) -> tuple[bpy.types.Object, ...]:
    clouds: list[tuple[str, np.ndarray | None, float, float, tuple[float, float, float, float]]] = [
        ("Triangulated keypoints", motion.keypoints3d, motion.fps, 0.014, KEYPOINT_COLOUR)
    ]
    if capture is not None:
        clouds.append(("Markers", capture.markers, capture.fps, 0.008, MARKER_COLOUR))
    folder = _collection("Detections", take)
    overlays = [
        create_point_overlay(name, points, fps, timing, folder, radius_m=radius_m, colour=colour)
        for name, points, fps, radius_m, colour in clouds
        if points is not None and points.size
    ]
    if capture is not None and capture.xy is not None and capture.xy.size:
        for camera, source, xy in zip(cameras, capture.cameras, capture.xy, strict=True):
            overlays.append(create_view_overlay(camera, source, xy, capture.fps, timing, folder, DETECTION_COLOUR))
    return tuple(overlays)
