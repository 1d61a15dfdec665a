"""Create Blender cameras from the capture's cameras, and show their footage in the background.

A Blender camera is a pinhole and shows an undistorted image, but the footage behind it is distorted. If the lens
distorts strongly, the corners of the footage do not match, while the detections and the body are correct.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
from mathutils import Matrix

from .._exchange.capture_file import CameraFile, CaptureFile
from .._exchange.plain_text import plain
from ..conventions.coordinates import SENSOR_WIDTH_MM, camera_to_world, lens_from_intrinsics
from ..conventions.file_paths import stored
from ..conventions.timing import TakeTiming

_VIDEOS = frozenset({".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".mts", ".wmv"})
_IMAGES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga", ".webp"})


@dataclass(frozen=True)
class Footage:
    """The video or image sequence that one camera recorded."""

    files: tuple[Path, ...]  # The video file, or the images in order.

    @property
    def is_video(self) -> bool:
        """True for a video file, False for an image sequence."""
        return self.files[0].suffix.lower() in _VIDEOS


def find_footage(path: Path | None) -> Footage | None:
    """Return the footage found at the path of a video or image folder, or None if the path does not exist."""
    if path is None:
        return None
    if os.path.isfile(path) and path.suffix.lower() in _VIDEOS | _IMAGES:
        return Footage((path,))
    if os.path.isdir(path):
        images = sorted((p for p in path.iterdir() if p.suffix.lower() in _IMAGES), key=_natural)
        return Footage(tuple(images)) if images else None
    return None


def near_footage(capture: CaptureFile, folders: Sequence[Path]) -> tuple[CaptureFile, tuple[str, ...]]:
    """Return the capture without footage outside the user's folders, and messages about what was removed.

    Another person's capture may name any file on this machine, or a server that would then receive the user's name.
    Paths are compared as text, so that no file is accessed before it is allowed.
    """
    cameras, refused = [], []
    for camera in capture.cameras:
        outside = camera.footage is not None and not any(_lies_in(camera.footage, folder) for folder in folders)
        if outside:
            name, path = plain(camera.name), plain(str(camera.footage))
            refused.append(
                f"Camera {name}: its footage is outside the capture's folder and was not opened: {path}. "
                "If you trust the capture, add its folder with --footage-from, or enable Footage Anywhere."
            )
        cameras.append(replace(camera, footage=None) if outside else camera)
    return replace(capture, cameras=tuple(cameras)), tuple(refused)


def _lies_in(path: Path, folder: Path) -> bool:
    """Return whether a path is inside a folder. Only the text of both paths is compared."""
    full, base = (os.path.normcase(os.path.abspath(p)) for p in (path, folder))
    if any(text.startswith(("\\\\", "//")) for text in (str(path), full)) and not base.startswith(("\\\\", "//")):
        return False
    if os.path.splitdrive(full)[0] != os.path.splitdrive(base)[0]:
        return False
    return os.path.commonpath([full, base]) == base


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that places img_2 before img_10."""
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", path.name.lower())]


FOOTAGE_RATE = "footage_fps"  # Custom property of a camera: the frame rate of its footage, in images per second.
_LAID, _START, _OFFSET, _COUNT = "footage_scene_fps", "footage_start", "footage_offset", "footage_count"
_OFFSET_PATH = "background_images[0].image_user.frame_offset"


def _remember_footage(camera: bpy.types.Camera, fps: float) -> None:
    user = camera.background_images[0].image_user
    camera[FOOTAGE_RATE], camera[_START] = fps, float(user.frame_start)
    camera[_OFFSET], camera[_COUNT] = user.frame_offset, user.frame_duration


def laid_footage_rate(camera: bpy.types.Camera) -> float:
    """Return the scene frame rate that a camera's footage was placed for."""
    return float(camera[_LAID])


def lay_footage(camera: bpy.types.Camera, timing: TakeTiming) -> None:
    """Time a camera's footage so that every scene frame shows the image that was recorded at that time."""
    user, count = camera.background_images[0].image_user, int(camera[_COUNT])
    rate = camera[FOOTAGE_RATE] / timing.scene_fps
    camera[_LAID] = timing.scene_fps
    camera.driver_remove(_OFFSET_PATH)
    user.frame_offset = camera[_OFFSET]
    user.frame_duration = 1 + math.ceil((count - 1) / rate - 1e-6)
    if abs(rate - 1) < 1e-6:
        return
    at = f"min(max(floor(frame-{timing.start:g}),0),{user.frame_duration - 1})"
    driver = camera.driver_add(_OFFSET_PATH).driver
    driver.type = "SCRIPTED"
    driver.expression = f"min(floor({at}*{rate:.9g}+0.5),{count - 1})-{at}+{int(camera[_OFFSET])}"


CAMERA_NAME = "capture_camera"  # Custom property of a camera's data: the camera's name in the capture.


def create_camera(source: CameraFile, collection: bpy.types.Collection) -> bpy.types.Object:
    """Create a Blender camera from a capture's camera. Custom properties store its name and image size."""
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
    """Make a camera the scene's camera, and adopt its pixel aspect and image size."""
    width, height = camera.data["image_size"]
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = int(width), int(height)
    scene.render.resolution_percentage = max(1, round(100 * scale))
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = camera.data["pixel_aspect"]


def add_background(camera: bpy.types.Object, source: CameraFile, fps: float, timing: TakeTiming) -> str:
    """Show footage in the camera's background. Return a message if the footage is missing."""
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
    _remember_footage(camera.data, fps)
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
    digits = "".join(c if c.isdecimal() else " " for c in path.stem).split()
    return int(digits[-1]) if digits else 1
