"""Footage on disk: a video file or a numbered sequence of images; and which of it a capture may name."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy

from .._exchange.capture_file import CaptureFile
from .._exchange.plain_text import plain
from ..conventions.timing import TakeTiming

_VIDEOS = frozenset({".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mpg", ".mpeg", ".mts", ".wmv"})
_IMAGES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga", ".webp"})


@dataclass(frozen=True)
class Footage:
    """What one camera saw."""

    files: tuple[Path, ...]
    """The video, or the images in order."""

    @property
    def is_video(self) -> bool:
        """Whether it is a video file."""
        return self.files[0].suffix.lower() in _VIDEOS


def find_footage(path: Path | None) -> Footage | None:
    """Return the footage at a path, or None where there is no video and no image.

    Args:
        path: a video, a folder of images, or None.
    """
    if path is None:
        return None
    if os.path.isfile(path) and path.suffix.lower() in _VIDEOS | _IMAGES:
        return Footage((path,))
    if os.path.isdir(path):
        images = sorted((p for p in path.iterdir() if p.suffix.lower() in _IMAGES), key=_natural)
        return Footage(tuple(images)) if images else None
    return None


def near_footage(capture: CaptureFile, folders: Sequence[Path]) -> tuple[CaptureFile, tuple[str, ...]]:
    """Return the capture without the footage that lies outside of some folders, and a sentence for each that does.

    Somebody else's capture may name any file of this machine, or a server that would be asked with the user's name.
    Paths are compared as text: nothing is looked for before it is allowed.

    Args:
        capture: as it was read.
        folders: those that the user has chosen; what lies in them may be shown.
    """
    cameras, refused = [], []
    for camera in capture.cameras:
        outside = camera.footage is not None and not any(_lies_in(camera.footage, folder) for folder in folders)
        if outside:
            refused.append(
                f"Camera {plain(camera.name)}: its footage lies outside of the capture's folder and was not looked "
                f"for: {plain(str(camera.footage))}. If you trust the capture, name its folder with "
                "--footage-from, or tick Footage Anywhere."
            )
        cameras.append(replace(camera, footage=None) if outside else camera)
    return replace(capture, cameras=tuple(cameras)), tuple(refused)


def _lies_in(path: Path, folder: Path) -> bool:
    """Return whether a path lies in a folder, by their names alone."""
    full, base = (os.path.normcase(os.path.abspath(p)) for p in (path, folder))
    if any(text.startswith(("\\\\", "//")) for text in (str(path), full)) and not base.startswith(("\\\\", "//")):
        return False
    if os.path.splitdrive(full)[0] != os.path.splitdrive(base)[0]:
        return False
    return os.path.commonpath([full, base]) == base


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort img_2 before img_10."""
    return [(int(part), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", path.name.lower())]


FOOTAGE_RATE = "footage_fps"
"""Custom property of a camera: pictures per second of its footage."""
_LAID, _START, _OFFSET, _COUNT = "footage_scene_fps", "footage_start", "footage_offset", "footage_count"
_PATH = "background_images[0].image_user.frame_offset"


def remember_footage(camera: bpy.types.Camera, fps: float) -> None:
    """Keep what the footage behind a camera is as it was set in Blender: one picture a frame."""
    user = camera.background_images[0].image_user
    camera[FOOTAGE_RATE], camera[_START] = fps, float(user.frame_start)
    camera[_OFFSET], camera[_COUNT] = user.frame_offset, user.frame_duration


def laid_footage_rate(camera: bpy.types.Camera) -> float:
    """Return the scene rate that the footage is laid by."""
    return float(camera[_LAID])


def lay_footage(camera: bpy.types.Camera, timing: TakeTiming) -> None:
    """Show on every scene frame the picture that was taken then; none but a driver of its number is added."""
    user, count = camera.background_images[0].image_user, int(camera[_COUNT])
    rate = camera[FOOTAGE_RATE] / timing.scene_fps
    camera[_LAID] = timing.scene_fps
    camera.driver_remove(_PATH)
    user.frame_offset = camera[_OFFSET]
    user.frame_duration = 1 + math.ceil((count - 1) / rate - 1e-6)
    if abs(rate - 1) < 1e-6:
        return
    at = f"min(max(floor(frame-{timing.start:g}),0),{user.frame_duration - 1})"
    driver = camera.driver_add(_PATH).driver
    driver.type = "SCRIPTED"
    driver.expression = f"min(floor({at}*{rate:.9g}+0.5),{count - 1})-{at}+{int(camera[_OFFSET])}"
