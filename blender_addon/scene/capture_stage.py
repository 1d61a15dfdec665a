"""The stage of a capture: its cameras, what they detected, and the floor; there before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile, CaptureFile
from ..conventions.collections import child_collection
from ..conventions.materials import MARKER_COLOUR
from ..conventions.timing import TakeTiming, set_scene_frame_rate
from .cameras import add_background, create_camera, look_through
from .floor import create_floor
from .overlay import PointLook, create_point_overlay, create_view_overlay

_MARKER_LOOK = PointLook(0.008, MARKER_COLOUR)


@dataclass(frozen=True)
class CaptureStage:
    """The objects of one capture."""

    collection: bpy.types.Collection
    """Holds everything of the capture."""
    cameras: tuple[bpy.types.Object, ...]
    overlays: tuple[bpy.types.Object, ...]
    floor: bpy.types.Object
    timing: TakeTiming
    notes: tuple[str, ...]
    """What was missing, one sentence each."""


def set_stage(scene: bpy.types.Scene, capture: CaptureFile, *, frame_start: int) -> CaptureStage:
    """Set up a capture in a scene, which takes over its frame rate, length and first camera.

    Args:
        scene: the scene to add to; nothing that is there is changed.
        capture: the capture.
        frame_start: scene frame of the capture's first frame.
    """
    set_scene_frame_rate(scene, capture.fps)
    timing = TakeTiming(frame_start, capture.fps)
    scene.frame_start, scene.frame_end = frame_start, timing.last_frame(max(1, capture.num_frames), capture.fps)
    collection = child_collection(capture.name, scene.collection)
    cameras, notes = create_cameras(capture, collection, frame_start=frame_start)
    if cameras:
        look_through(scene, cameras[0])
    overlays = create_detections(capture, cameras, timing, child_collection("Detections", collection))
    floor = create_floor(_ground_points(capture), child_collection("Floor", collection), margin_m=1.0)
    scene.frame_set(frame_start)
    return CaptureStage(collection, cameras, overlays, floor, timing, notes)


def create_cameras(
    capture: CaptureFile, parent: bpy.types.Collection, *, frame_start: int, backgrounds: bool = True
) -> tuple[tuple[bpy.types.Object, ...], tuple[str, ...]]:
    """Create a capture's cameras, with their footage behind the view, and say what is missing."""
    if not capture.cameras:
        return (), ()
    folder = child_collection("Cameras", parent)
    cameras = tuple(create_camera(source, folder) for source in capture.cameras)
    notes: list[str] = []
    for camera, source in zip(cameras, capture.cameras, strict=True):
        notes += _lens_notes(source)
        note = add_background(camera, source, frame_start=frame_start) if backgrounds else ""
        notes += [note] if note else []
    return cameras, tuple(notes)


def create_detections(
    capture: CaptureFile, cameras: tuple[bpy.types.Object, ...], timing: TakeTiming, folder: bpy.types.Collection
) -> tuple[bpy.types.Object, ...]:
    """Create the points each camera detected, as that camera sees them, and the optical markers."""
    overlays = []
    if capture.markers is not None and capture.markers.size:
        cloud = create_point_overlay("Markers", capture.markers, capture.fps, timing, folder, _MARKER_LOOK)
        overlays.append(cloud)
    if capture.xy is not None and capture.xy.size:
        for camera, source, xy in zip(cameras, capture.cameras, capture.xy, strict=True):
            overlays.append(create_view_overlay(camera, source, xy, capture.fps, timing, folder))
    return tuple(overlays)


def _lens_notes(source: CameraFile) -> list[str]:
    skew = abs(source.K[0, 1])
    return [f"Camera {source.name}: its skew of {skew:.2g} px is left out."] if skew > 0.01 else []


def _ground_points(capture: CaptureFile) -> np.ndarray:
    """Return (N, 3) world metres that the floor lies under: where the cameras and the markers are."""
    centres = np.array([-source.R.T @ source.t for source in capture.cameras]).reshape(-1, 3)
    markers = np.zeros((0, 3)) if capture.markers is None else capture.markers.reshape(-1, 3)
    return np.concatenate([centres, markers])
