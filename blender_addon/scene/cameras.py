"""Blender cameras at the capture's cameras, with their footage behind the view.

A Blender camera is a pinhole and shows the undistorted image. Footage behind it is distorted, so with a strongly
distorting lens the corners of the image are off, but the detections and the body are not.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from mathutils import Matrix

from .._exchange.capture_file import CameraFile
from ..conventions.coordinates import SENSOR_WIDTH_MM, camera_to_world, lens_from_intrinsics
from ..conventions.file_paths import stored
from ..conventions.timing import TakeTiming
from .footage import Footage, find_footage, lay_footage, remember_footage

CAMERA_NAME = "capture_camera"
"""Custom property of a camera's data: its name in the capture."""


def create_camera(source: CameraFile, collection: bpy.types.Collection) -> bpy.types.Object:
    """Create a camera with the capture's name, and store its image size in custom properties."""
    data = bpy.data.cameras.new(source.name)
    lens = lens_from_intrinsics(source.K, source.image_size)
    data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", SENSOR_WIDTH_MM, lens.focal_mm
    data.shift_x, data.shift_y = lens.shift_x, lens.shift_y
    data.clip_start, data.clip_end, data.display_size = 0.05, 500.0, 0.25
    data[CAMERA_NAME] = source.name
    data["image_size"] = list(source.image_size)
    data["pixel_aspect"] = list(lens.pixel_aspect)
    camera = bpy.data.objects.new(source.name, data)
    camera.matrix_world = Matrix(camera_to_world(source.R, source.t).tolist())
    collection.objects.link(camera)
    return camera


def look_through(scene: bpy.types.Scene, camera: bpy.types.Object, *, scale: float = 1.0) -> None:
    """Make a camera from ``create_camera`` the scene's, with its pixel aspect and its image size times ``scale``."""
    width, height = camera.data["image_size"]
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
    scene.render.resolution_percentage = max(1, round(100 * scale))
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = camera.data["pixel_aspect"]


def add_background(camera: bpy.types.Object, source: CameraFile, fps: float, timing: TakeTiming) -> str:
    """Show the footage behind the camera's view, synchronised by time.

    Args:
        camera: from ``create_camera``.
        source: its calibrated camera with the footage.
        fps: images per second.
        timing: position of the take in the scene.

    Returns:
        A sentence about missing footage, or "".
    """
    footage = find_footage(source.footage)
    if footage is None:
        return "" if source.footage is None else f"Camera {source.name}: no video or images at {source.footage}."
    image = _load(footage)
    if image is None:
        return f"Camera {source.name}: Blender cannot read {footage.files[0].name}."
    background = camera.data.background_images.new()
    background.image, background.alpha = image, 1.0
    background.display_depth, background.frame_method = "BACK", "STRETCH"
    user = background.image_user
    user.frame_start = int(timing.start)
    pictures = image.frame_duration if footage.is_video else len(footage.files)
    user.frame_duration = max(1, pictures - source.footage_first)
    first = 0 if footage.is_video else _first_number(footage.files[0]) - 1
    user.frame_offset = first + source.footage_first
    user.use_auto_refresh = True
    camera.data.show_background_images = True
    remember_footage(camera.data, fps)
    lay_footage(camera.data, timing)
    return ""


def _load(footage: Footage) -> bpy.types.Image | None:
    try:
        image = bpy.data.images.load(stored(footage.files[0]), check_existing=True)
    except RuntimeError:
        return None
    if image.size[0] == 0:
        bpy.data.images.remove(image)
        return None
    if not footage.is_video and len(footage.files) > 1:
        image.source = "SEQUENCE"
    return image


def _first_number(path: Path) -> int:
    digits = "".join(c if c.isdigit() else " " for c in path.stem).split()
    return int(digits[-1]) if digits else 1
