"""Footage on disk: a video file or a numbered sequence of images, and which of it a capture may use."""

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
    """Footage of one camera."""

    files: tuple[Path, ...]
    """The video, or the images in order."""

    @property
    def is_video(self) -> bool:
        """Whether it is a video file."""
        return self.files[0].suffix.lower() in _VIDEOS


def find_footage(path: Path | None) -> Footage | None:
    """Return the footage at a path to a video or a folder of images, None if there is none."""
    if path is None:
        return None
    if os.path.isfile(path) and path.suffix.lower() in _VIDEOS | _IMAGES:
        return Footage((path,))
    if os.path.isdir(path):
        images = sorted((p for p in path.iterdir() if p.suffix.lower() in _IMAGES), key=_natural)
        return Footage(tuple(images)) if images else None
    return None


def near_footage(capture: CaptureFile, folders: Sequence[Path]) -> tuple[CaptureFile, tuple[str, ...]]:
    """Return the capture without footage outside some folders, and a sentence for each camera that lost its footage.

    Another person's capture may name any file of this machine, or a server that would be asked with the user's name.
    Paths are compared as text, so that no file is looked for before it is allowed.

    Args:
        capture: the capture.
        folders: the user's folders, whose contents may be shown.
    """
    cameras, refused = [], []
    for camera in capture.cameras:
        outside = camera.footage is not None and not any(_lies_in(camera.footage, folder) for folder in folders)
        if outside:
            name, path = plain(camera.name), plain(str(camera.footage))
            refused.append(
                f"Camera {name}: its footage lies outside of the capture's folder and was not looked for: {path}. "
                "If you trust the capture, name its folder with --footage-from, or tick Footage Anywhere."
            )
        cameras.append(replace(camera, footage=None) if outside else camera)
    return replace(capture, cameras=tuple(cameras)), tuple(refused)


def _lies_in(path: Path, folder: Path) -> bool:
    """Return whether a path is in a folder, by their names alone."""
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
"""Custom property of a camera: images per second of its footage."""
_LAID, _START, _OFFSET, _COUNT = "footage_scene_fps", "footage_start", "footage_offset", "footage_count"
_PATH = "background_images[0].image_user.frame_offset"


def remember_footage(camera: bpy.types.Camera, fps: float) -> None:
    """Store the settings of the footage behind a camera with one image per frame."""
    user = camera.background_images[0].image_user
    camera[FOOTAGE_RATE], camera[_START] = fps, float(user.frame_start)
    camera[_OFFSET], camera[_COUNT] = user.frame_offset, user.frame_duration


def laid_footage_rate(camera: bpy.types.Camera) -> float:
    """Return the scene frame rate for which the footage is placed."""
    return float(camera[_LAID])


def lay_footage(camera: bpy.types.Camera, timing: TakeTiming) -> None:
    """Show on each scene frame the image of its time, by a driver of the image number if the rates differ."""
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
