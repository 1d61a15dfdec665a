"""Detections as overlay objects: the keypoints of each view on its camera's image plane, and 3D points in the room."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile
from .._exchange.lens import normalised, undistort
from ..conventions.coordinates import camera_rays
from ..conventions.materials import DETECTION_COLOUR, Colour, create_material
from ..conventions.timing import TakeTiming
from .point_player import GRADE, MODIFIER, POINTS, SEEN, PlayerSettings, create_player

_PLANE_M = 0.5
"""Distance of a view's detections from its camera."""
_DOT = 0.0045
"""Radius of a detection, as a share of the image's longer side: three pixels of a usual viewport."""


@dataclass(frozen=True)
class PointLook:
    """What points look like."""

    radius_m: float
    """Radius of a point."""
    colours: tuple[Colour, ...]
    """Linear RGBA; several where points are graded (see ``point_player.GRADE``)."""


def create_point_overlay(
    name: str,
    points: np.ndarray,
    fps: float,
    timing: TakeTiming,
    collection: bpy.types.Collection,
    look: PointLook,
) -> bpy.types.Object:
    """Create one object that plays points; it is shown in the viewport and left out of renders.

    Args:
        name: name of the object.
        points: (F, K, 3) metres in the object's frame, NaN where unseen.
        fps: frames per second of the points.
        timing: where the take lies in the scene.
        collection: where the object is linked.
        look: size and colours of a point.
    """
    rows, count = points.shape[:2]
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(rows * count)
    seen = np.isfinite(points).all(axis=-1).reshape(-1)
    mesh.vertices.foreach_set("co", np.where(seen[:, None], points.reshape(-1, 3), 0.0).astype(np.float32).ravel())
    mesh.attributes.new(SEEN, "FLOAT", "POINT").data.foreach_set("value", seen.astype(np.float32))
    if len(look.colours) > 1:
        mesh.attributes.new(GRADE, "FLOAT", "POINT")
    overlay = bpy.data.objects.new(name, mesh)
    collection.objects.link(overlay)
    settings = PlayerSettings(
        points=count, rows=rows, frame_start=timing.start, rows_per_frame=fps / timing.scene_fps,
        radius_m=look.radius_m, materials=tuple(create_material(name, colour) for colour in look.colours),
    )  # fmt: skip
    overlay["fps"], overlay[POINTS] = fps, count
    overlay.modifiers.new(MODIFIER, "NODES").node_group = create_player(name, settings)
    overlay.hide_render = True
    overlay.show_in_front = True
    overlay.hide_select = True
    return overlay


def seen_share(overlay: bpy.types.Object) -> float:
    """Return the share, 0..1, of an overlay's points that are there."""
    seen = np.zeros(len(overlay.data.vertices), np.float32)
    if len(seen):
        overlay.data.attributes[SEEN].data.foreach_get("value", seen)
    return float(seen.mean()) if len(seen) else 0.0


def create_view_overlay(
    camera: bpy.types.Object,
    source: CameraFile,
    xy: np.ndarray,
    fps: float,
    timing: TakeTiming,
    collection: bpy.types.Collection,
) -> bpy.types.Object:
    """Create one view's detections as a child of its camera, half a metre in front of it.

    Seen through the camera they lie where the undistorted image has them.

    Args:
        camera: the Blender camera.
        source: the calibrated camera.
        xy: (F, K, 2) distorted pixels, NaN where unseen.
        fps: frames per second of the detections.
        timing: where the take lies in the scene.
        collection: where the object is linked.
    """
    radius_m = _DOT * _PLANE_M * max(source.image_size) / source.K[1, 1]
    points = _PLANE_M * camera_rays(undistort(normalised(xy, source.K), source.distortion, source.distortion_model))
    look = PointLook(radius_m, (DETECTION_COLOUR,))
    overlay = create_point_overlay(f"{source.name} detections", points, fps, timing, collection, look)
    overlay.parent = camera
    return overlay
