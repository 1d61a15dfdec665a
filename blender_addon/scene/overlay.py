"""Detections as overlay objects: the keypoints of each view on its camera's image plane, and 3D points in the room."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile
from .._exchange.lens import normalised, undistort
from ..conventions.coordinates import camera_rays
from ..conventions.datablocks import DETECTION_COLOUR, Colour, create_material, set_input
from ..conventions.timing import TakeTiming
from .point_player import GRADE, MODIFIER, POINTS, RADIUS, SEEN, PlayerSettings, create_player

_PLANE_M = 0.5
"""Distance of a view's detections from its camera."""
_DOT = 0.0045
"""Radius of a detection by the image's longer side: three pixels of a usual viewport."""


@dataclass(frozen=True)
class PointLook:
    """Radius and colours of points."""

    radius_m: float
    colours: tuple[Colour, ...]
    """Linear RGBA, several for graded points (see ``point_player.GRADE``)."""


Players = dict[tuple[object, ...], bpy.types.NodeTree]
"""Node groups that overlays share if they play alike, as each takes 60 kB of a file."""


def create_point_overlay(
    name: str,
    points: np.ndarray,
    fps: float,
    timing: TakeTiming,
    collection: bpy.types.Collection,
    look: PointLook,
    players: Players | None = None,
) -> bpy.types.Object:
    """Create one object that plays points in the viewport, not in renders.

    Args:
        name: name of the object.
        points: (F, K, 3) metres in the object's frame, NaN if unseen.
        fps: frames per second of the points.
        timing: position of the take in the scene.
        collection: the object's collection.
        look: size and colours of a point.
        players: node groups of earlier overlays to share, to which a new one is added.
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
    overlay["fps"], overlay[POINTS] = fps, count
    key = (count, rows, timing.start, fps / timing.scene_fps, look.colours)
    players = {} if players is None else players
    if key not in players:
        materials = tuple(create_material(name, colour) for colour in look.colours)
        players[key] = create_player(name, PlayerSettings(*key[:4], materials))
    modifier = overlay.modifiers.new(MODIFIER, "NODES")
    modifier.node_group = players[key]
    set_input(modifier, RADIUS, look.radius_m)
    overlay.hide_render = overlay.show_in_front = overlay.hide_select = True
    return overlay


def seen_share(overlay: bpy.types.Object) -> float:
    """Return the share, 0..1, of an overlay's points that are seen."""
    seen = np.zeros(len(overlay.data.vertices), np.float32)
    if not len(seen):
        return 0.0
    overlay.data.attributes[SEEN].data.foreach_get("value", seen)
    return float(seen.mean())


def create_view_overlay(
    camera: bpy.types.Object,
    source: CameraFile,
    xy: np.ndarray,
    fps: float,
    timing: TakeTiming,
    collection: bpy.types.Collection,
    players: Players | None = None,
) -> bpy.types.Object:
    """Create one view's detections as a child of its camera, half a metre in front of it.

    Through the camera they appear at their positions in the undistorted image.

    Args:
        camera: the Blender camera.
        source: the calibrated camera.
        xy: (F, K, 2) distorted pixels, NaN if unseen.
        fps: frames per second of the detections.
        timing: position of the take in the scene.
        collection: the object's collection.
        players: see ``create_point_overlay``.
    """
    radius_m = _DOT * _PLANE_M * max(source.image_size) / source.K[1, 1]
    points = _PLANE_M * camera_rays(undistort(normalised(xy, source.K), source.distortion, source.distortion_model))
    look = PointLook(radius_m, (DETECTION_COLOUR,))
    overlay = create_point_overlay(f"{source.name} detections", points, fps, timing, collection, look, players)
    overlay.parent = camera
    return overlay
