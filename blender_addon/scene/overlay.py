"""Overlay objects that show detections, 3D keypoints and markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile
from .._exchange.lens import normalised, undistort
from .._exchange.motion_file import MotionFile
from ..conventions.coordinates import camera_rays
from ..conventions.datablocks import DETECTION_COLOUR, MARKER_COLOURS, Colour, create_material, set_input
from ..conventions.timing import TakeTiming
from .point_player import GRADE, MODIFIER, POINTS, RADIUS, SEEN, PlayerSettings, create_player, played_row

_PLANE_M = 0.5  # Distance in metres from a camera to the plane that shows its detections.
_DOT = 0.0045  # Radius of a detection as a fraction of the image's longer side. It is about three viewport pixels.


@dataclass(frozen=True)
class PointLook:
    """Radius and colours of the balls that show points."""

    radius_m: float
    colours: tuple[Colour, ...]  # Linear RGBA. Graded points need several colours (see ``point_player.GRADE``).


Players = dict[tuple[object, ...], bpy.types.NodeTree]
"""Node groups shared by overlays that have equal settings. Each group takes 60 kB in a file."""


def create_point_overlay(
    name: str,
    points: np.ndarray,
    fps: float,
    timing: TakeTiming,
    collection: bpy.types.Collection,
    look: PointLook,
    players: Players | None = None,
) -> bpy.types.Object:
    """Create one object that plays (F, K, 3) points in the viewport, in metres and NaN where unseen."""
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
    """Return the fraction of an overlay's points that are visible (0 to 1)."""
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
    """Create an overlay that shows (F, K, 2) detections, undistorted, as a child of the camera."""
    radius_m = _DOT * _PLANE_M * max(source.image_size) / source.K[1, 1]
    points = _PLANE_M * camera_rays(undistort(normalised(xy, source.K), source.distortion, source.distortion_model))
    look = PointLook(radius_m, (DETECTION_COLOUR,))
    overlay = create_point_overlay(f"{source.name} detections", points, fps, timing, collection, look, players)
    overlay.parent = camera
    return overlay


BOUNDS_MM = (10.0, 25.0)  # Largest residual in mm of a marker near the body, and of one off the body.
LABELS = "marker_labels"
"""Custom property of the object: one marker label per line, in the order of the points."""
_MARKER_LOOK = PointLook(0.008, MARKER_COLOURS)
"""Radius in metres, similar to a real marker, and colours. Chosen by hand."""


def create_marker_cloud(
    markers: np.ndarray, labels: Sequence[str], fps: float, timing: TakeTiming, collection: bpy.types.Collection
) -> bpy.types.Object:
    """Create an object that shows (F, M, 3) markers in metres, NaN where unseen. ``labels`` has M labels or none."""
    cloud = create_point_overlay("Markers", markers, fps, timing, collection, _MARKER_LOOK)
    cloud[LABELS] = "\n".join(labels or (f"*{number}" for number in range(1, markers.shape[1] + 1)))
    return cloud


def labels_of(cloud: bpy.types.Object) -> list[str]:
    """Return the label of each marker in a marker object, in the order of its points."""
    return str(cloud.get(LABELS, "")).split("\n")


def grade_markers(cloud: bpy.types.Object, motion: MotionFile | None) -> None:
    """Colour each marker in each frame by its residual in a motion, or neutrally without a residual."""
    labels = labels_of(cloud)
    grades = np.zeros((len(cloud.data.vertices) // len(labels), len(labels)), np.float32)
    if motion is not None and motion.marker_residual_mm is not None:
        column = {label: i for i, label in enumerate(motion.marker_labels)}
        solved = [i for i, label in enumerate(labels) if label in column]
        residual = motion.marker_residual_mm[: len(grades), [column[labels[i]] for i in solved]]
        grades[: len(residual), solved] = np.where(np.isfinite(residual), 1 + np.searchsorted(BOUNDS_MM, residual), 0)
    cloud.data.attributes[GRADE].data.foreach_set("value", grades.ravel())
    cloud.data.update_tag()


def marker_positions(cloud: bpy.types.Object, frame: float) -> dict[str, tuple[float, float, float]]:
    """Return the positions of markers visible at a scene frame, in the object's coordinates, keyed by label."""
    count, vertices, seen = int(cloud[POINTS]), cloud.data.vertices, cloud.data.attributes[SEEN].data
    first = played_row(cloud, frame) * count
    return {
        label: tuple(vertices[first + i].co) for i, label in enumerate(labels_of(cloud)) if seen[first + i].value > 0.5
    }
