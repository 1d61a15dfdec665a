"""Show a capture before it is solved: cameras, detections and floor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile, CaptureFile
from .._exchange.motion_file import MotionFile
from ..conventions.coordinates import fit_units
from ..conventions.datablocks import FLOOR_COLOURS, child_collection, create_material, get_input, set_input
from ..conventions.timing import TakeTiming, set_up_time, show_frame
from .cameras import FOOTAGE_RATE, add_background, create_camera, look_through
from .overlay import Players, create_marker_cloud, create_view_overlay, grade_markers
from .point_player import MODIFIER, RADIUS, player_of

_LINE_M = 0.015  # Width of a grid line in metres. Chosen by hand.
_MOST_TILES = 200
"""Most tiles per side. Larger floors get larger tiles: 20 km of 1 m tiles would take 3 GB. Chosen by hand."""


def create_floor(points: np.ndarray, collection: bpy.types.Collection, *, margin_m: float = 2.0) -> bpy.types.Object:
    """Create a floor of 1 m tiles under (..., 3) points, extended by a margin in metres."""
    flat = points.reshape(-1, 3)[:, :2]
    flat = flat[np.isfinite(flat).all(axis=1)]
    low = np.floor(flat.min(axis=0) - margin_m) if len(flat) else np.array([-2.0, -2.0])
    high = np.ceil(flat.max(axis=0) + margin_m) if len(flat) else np.array([2.0, 2.0])
    vertices, faces, is_line = _tiles(low, high)
    mesh = bpy.data.meshes.new("Floor")
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    for name, colour in zip(("Floor", "Floor lines"), FLOOR_COLOURS, strict=True):
        mesh.materials.append(create_material(name, colour, roughness=0.9))
    mesh.polygons.foreach_set("material_index", is_line.astype(np.int32))
    mesh.update()
    floor = bpy.data.objects.new("Floor", mesh)
    floor.hide_select = True
    collection.objects.link(floor)
    return floor


def _tiles(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a tiled floor: vertices (N, 3), quads (M, 4), and a mask (M,) of the quads that are grid lines."""
    tile = max(1.0, float(np.ceil((high - low).max() / _MOST_TILES)))
    steps = [_steps(low[axis], high[axis], tile) for axis in (0, 1)]
    x, y = np.meshgrid(*steps, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    columns, rows = len(steps[0]), len(steps[1])
    i, j = np.meshgrid(np.arange(columns - 1), np.arange(rows - 1), indexing="ij")
    first = i * rows + j
    faces = np.stack([first, first + rows, first + rows + 1, first + 1], axis=-1).reshape(-1, 4)
    # Lines and tiles alternate. Even intervals are lines.
    return vertices, faces, ((i % 2 == 0) | (j % 2 == 0)).reshape(-1)


def _steps(low: float, high: float, tile: float) -> np.ndarray:
    metres = np.arange(low, high + tile - 0.5, tile)
    return np.stack([metres - _LINE_M / 2, metres + _LINE_M / 2], axis=-1).reshape(-1)


@dataclass(frozen=True)
class CaptureStage:
    """Blender objects that show a capture before it is solved."""

    collection: bpy.types.Collection
    cameras: tuple[bpy.types.Object, ...]
    overlays: tuple[bpy.types.Object, ...]
    floor: bpy.types.Object
    timing: TakeTiming
    notes: tuple[str, ...]  # Messages for the user, one sentence each.


def set_stage(
    scene: bpy.types.Scene, capture: CaptureFile, *, frame_start: int, take_over: bool = True
) -> CaptureStage:
    """Create a capture's objects. With ``take_over``, the scene also gets the recording's rate, range and camera."""
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
    """Create a capture's cameras with their footage. Return the cameras, and notes about lenses and footage."""
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
    """Create point objects for each camera's detections and for the markers, coloured by a motion's residuals."""
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
    return [f"Camera {source.name}: its skew of {skew:.2g} px is ignored."] if skew > 0.01 else []


def _ground_points(capture: CaptureFile) -> np.ndarray:
    centres = np.array([-source.R.T @ source.t for source in capture.cameras]).reshape(-1, 3)
    markers = np.zeros((0, 3)) if capture.markers is None else capture.markers.reshape(-1, 3)
    return np.concatenate([centres, markers])


def replace_stage(
    scene: bpy.types.Scene, stage: CaptureStage, former: list[bpy.types.Object | None], collection: bpy.types.Collection
) -> CaptureStage:
    """Update a capture's existing objects with the data of a new stage, and keep the user's changes."""
    new = [*stage.cameras, *stage.overlays, stage.floor]
    kept = [_kept(scene, old, obj, collection) for old, obj in zip(former, new, strict=True)]
    for child in stage.collection.children:
        bpy.data.collections.remove(child)
    bpy.data.collections.remove(stage.collection)
    count = len(stage.cameras)
    objects = {"cameras": tuple(kept[:count]), "overlays": tuple(kept[count:-1])}
    return replace(stage, collection=collection, floor=kept[-1], **objects)


def _kept(
    scene: bpy.types.Scene, old: bpy.types.Object | None, new: bpy.types.Object, collection: bpy.types.Collection
) -> bpy.types.Object:
    if old is None:
        for home in tuple(new.users_collection):
            home.objects.unlink(new)
        collection.objects.link(new)
        return new
    data, old.data = old.data, new.data
    if old.type == "CAMERA":
        _take_view(old, data)
        old.matrix_world = new.matrix_world
    elif player_of(new) is not None:
        for key, value in new.items():
            old[key] = value
        old.modifiers[MODIFIER].node_group = player_of(new)
        set_input(old.modifiers[MODIFIER], RADIUS, get_input(new.modifiers[MODIFIER], RADIUS))
        old.parent = old.parent or new.parent  # detections lose their parent if the user deletes its camera
    for child in new.children:
        child.parent = old
    if scene.camera == new:
        scene.camera = old
    bpy.data.objects.remove(new)
    if data.users == 0:
        bpy.data.batch_remove((data,))
    return old


def _take_view(camera: bpy.types.Object, former: bpy.types.Camera) -> None:
    camera.data.display_size = former.display_size
    if FOOTAGE_RATE in camera.data and former.background_images:
        camera.data.background_images[0].alpha = former.background_images[0].alpha
        camera.data.show_background_images = former.show_background_images
