"""Footage in and video out through Blender's sequencer, in scenes of their own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..conventions.timing import set_scene_frame_rate
from ..errors import RenderFailed
from ..scene.cameras import Footage
from .stage import render_still, write_targa


@dataclass(frozen=True)
class FootageReader:
    """Reads single images of a video or an image sequence at a given size."""

    scene: bpy.types.Scene  # Renders the footage.
    folder: Path  # For temporary files.
    length: int  # Number of images.
    native_size: tuple[int, int]  # Width and height of the files' images in pixels.
    size: tuple[int, int]  # Width and height of the images that are returned.

    def image(self, index: int) -> np.ndarray:
        """Return image ``index`` (the last one beyond the end): (h, w, 3) uint8.

        Raises ``RenderFailed`` if the image cannot be decoded.
        """
        frame = 1 + min(max(index, 0), self.length - 1)
        return render_still(self.scene, frame, self.folder)[..., :3]


@contextmanager
def open_footage(footage: Footage, size: tuple[int, int], folder: Path) -> Iterator[FootageReader]:
    """Yield a reader that scales the footage to ``size`` (width, height)."""
    scene = _sequencer_scene("footage", size)
    try:
        write_targa(scene)
        if footage.is_video:
            file = os.path.abspath(footage.files[0])
            strip = _strips(scene).new_movie("footage", file, channel=1, frame_start=1, fit_method="STRETCH")
            if strip.fps > 0:
                set_scene_frame_rate(scene, strip.fps)
        else:
            strip = _image_strip(scene, list(footage.files))
        first = strip.elements[0]
        yield FootageReader(scene, folder, max(1, _length(strip)), (first.orig_width, first.orig_height), size)
    finally:
        bpy.data.scenes.remove(scene)


def encode_video(pictures: list[Path], size: tuple[int, int], fps: float, path: Path) -> None:
    """Write pictures as an H264 video in an mp4 file.

    Raises ``RenderFailed`` if this Blender wrote no video.

    Args:
        size: width and height, both even.
    """
    scene = _sequencer_scene("video", size)
    try:
        _image_strip(scene, pictures)
        set_scene_frame_rate(scene, fps)
        scene.frame_start, scene.frame_end = 1, len(pictures)
        settings = scene.render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "VIDEO"
        settings.file_format = "FFMPEG"
        settings.color_mode = "RGB"
        ffmpeg = scene.render.ffmpeg
        ffmpeg.format, ffmpeg.codec = "MPEG4", "H264"
        ffmpeg.constant_rate_factor, ffmpeg.ffmpeg_preset = "HIGH", "REALTIME"
        ffmpeg.gopsize = max(1, round(fps))
        ffmpeg.audio_codec = "NONE"
        scene.render.filepath = str(path)
        with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
            bpy.ops.render.render(animation=True)
    except (RuntimeError, TypeError) as error:
        raise RenderFailed(f"Blender cannot write H264 video ({error}).", where=path.name) from error
    finally:
        bpy.data.scenes.remove(scene)
    if not path.is_file() or not path.stat().st_size:
        raise RenderFailed("Blender wrote no video.", where=path.name, hint="Ask for no video.")


def _sequencer_scene(name: str, size: tuple[int, int]) -> bpy.types.Scene:
    scene = bpy.data.scenes.new(name)
    scene.sequence_editor_create()
    scene.sequencer_colorspace_settings.name = "sRGB"
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.use_sequencer = True
    return scene


def _strips(scene: bpy.types.Scene) -> Any:
    """Return the list of strips: ``strips`` since Blender 4.4, ``sequences`` before."""
    editor = scene.sequence_editor
    return editor.strips if hasattr(editor, "strips") else editor.sequences


def _image_strip(scene: bpy.types.Scene, files: list[Path]) -> Any:
    strip = _strips(scene).new_image(
        name="pictures", filepath=os.path.abspath(files[0]), channel=1, frame_start=1, fit_method="STRETCH"
    )
    for file in files[1:]:
        strip.elements.append(file.name)
    return strip


def _length(strip: Any) -> int:
    """Return the images of a strip: ``content_duration`` since Blender 5.2, ``frame_duration`` before."""
    return int(strip.content_duration if hasattr(strip, "content_duration") else strip.frame_duration)
