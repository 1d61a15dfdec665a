"""The stage of a capture: its cameras, what they detected, and the floor; there before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile, CaptureFile
from .._exchange.motion_file import MotionFile
from ..conventions.collections import child_collection
from ..conventions.timing import TakeTiming, set_up_time, show_frame
from ..conventions.units import fit_units
from .cameras import add_background, create_camera, look_through
from .floor import create_floor
from .marker_cloud import create_marker_cloud, grade_markers
from .overlay import Players, create_view_overlay


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


def set_stage(
    scene: bpy.types.Scene, capture: CaptureFile, *, frame_start: int, take_over: bool = True
) -> CaptureStage:
    """Set up a capture in a scene.

    Args:
        scene: the scene to add to; nothing that is there is changed.
        capture: the capture.
        frame_start: scene frame of the capture's first frame.
        take_over: the scene takes over frame rate, length and first camera; without, they and the frame shown stay,
            and the capture is laid by time.
    """
    frames = max(1, capture.num_frames)
    timing = set_up_time(scene, frames, capture.fps, frame_start, capture.fps if take_over else None)
    collection = child_collection(capture.name, scene.collection)
    cameras, notes = create_cameras(capture, collection, timing)
    if cameras and take_over:
        look_through(scene, cameras[0])
    overlays = create_detections(capture, cameras, timing, child_collection("Detections", collection))
    floor = create_floor(_ground_points(capture), child_collection("Floor", collection), margin_m=1.0)
    fit_units(scene, (*cameras, *overlays, floor))
    show_frame(scene, frame_start if take_over else None)
    return CaptureStage(collection, cameras, overlays, floor, timing, notes)


def create_cameras(
    capture: CaptureFile, parent: bpy.types.Collection, timing: TakeTiming, *, backgrounds: bool = True
) -> tuple[tuple[bpy.types.Object, ...], tuple[str, ...]]:
    """Create a capture's cameras, with their footage behind the view, and report what is missing."""
    if not capture.cameras:
        return (), ()
    folder = child_collection("Cameras", parent)
    cameras = tuple(create_camera(source, folder) for source in capture.cameras)
    notes: list[str] = []
    for camera, source in zip(cameras, capture.cameras, strict=True):
        notes += _lens_notes(source)
        note = add_background(camera, source, capture.fps, timing) if backgrounds else ""
        notes += [note] if note else []
    return cameras, tuple(notes)


def create_detections(
    capture: CaptureFile,
    cameras: tuple[bpy.types.Object, ...],
    timing: TakeTiming,
    folder: bpy.types.Collection,
    motion: MotionFile | None = None,
) -> tuple[bpy.types.Object, ...]:
    """Create the points each camera detected, as it sees them, and the markers, coloured by a motion's residuals."""
    overlays = []
    if capture.markers is not None and capture.markers.size:
        cloud = create_marker_cloud(capture.markers, capture.marker_labels, capture.fps, timing, folder)
        grade_markers(cloud, motion)
        overlays.append(cloud)
    if capture.xy is not None and capture.xy.size:
        players: Players = {}
        for camera, source, xy in zip(cameras, capture.cameras, capture.xy, strict=True):
            overlays.append(create_view_overlay(camera, source, xy, capture.fps, timing, folder, players))
    return tuple(overlays)


def _lens_notes(source: CameraFile) -> list[str]:
    skew = abs(source.K[0, 1])
    return [f"Camera {source.name}: its skew of {skew:.2g} px is left out."] if skew > 0.01 else []


def _ground_points(capture: CaptureFile) -> np.ndarray:
    """Return (N, 3) world metres that the floor lies under: where the cameras and the markers are."""
    centres = np.array([-source.R.T @ source.t for source in capture.cameras]).reshape(-1, 3)
    markers = np.zeros((0, 3)) if capture.markers is None else capture.markers.reshape(-1, 3)
    return np.concatenate([centres, markers])
