"""Create temporary scenes that render parts of a take, read footage and write videos."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..conventions.timing import go_to_frame, set_scene_frame_rate
from ..errors import RenderFailed
from ..scene.cameras import Footage, create_camera
from .picture import read_targa
from .view import View

_STUDIO = "paint.sl"  # Blender's brightest studio light.
Window = tuple[int, int, int, int]  # x0, y0, x1 and y1 of a part of a picture, in pixels from the top left corner.


@dataclass(frozen=True)
class RenderQuality:
    """Render quality of a stage. Averaging larger pictures is faster than rendering more samples per pixel."""

    shrink: int = 2  # Pictures are rendered larger by this factor and then averaged.
    cavity: bool = False  # Darken creases and brighten ridges.
    shadows: bool = False  # Cast hard shadows.


@dataclass(frozen=True)
class RenderStage:
    """A temporary scene that renders one view of some collections."""

    scene: bpy.types.Scene
    view: View
    look: RenderQuality
    folder: Path

    def render(self, frame: float, window: Window | None = None) -> np.ndarray:
        """Render the view, or a window of it, as (h, w, 4) uint8 RGBA, enlarged by the factor ``look.shrink``."""
        render = self.scene.render
        render.use_border = render.use_crop_to_border = window is not None
        if window is not None:
            self._set_border(window)
        return render_still(self.scene, frame, self.folder)

    def _set_border(self, window: Window) -> None:
        width, height = self.view.size
        x0, y0, x1, y1 = window
        # Blender truncates the border to whole pixels, so a quarter of a pixel is added to avoid rounding errors.
        nudge_x, nudge_y = 0.25 / (width * self.look.shrink), 0.25 / (height * self.look.shrink)
        render = self.scene.render
        render.border_min_x, render.border_max_x = x0 / width + nudge_x, x1 / width + nudge_x
        render.border_min_y, render.border_max_y = 1 - y1 / height + nudge_y, 1 - y0 / height + nudge_y


@contextmanager
def open_stage(
    name: str, collections: tuple[bpy.types.Collection, ...], view: View, look: RenderQuality, folder: Path
) -> Iterator[RenderStage]:
    """Yield a stage that shows these collections in a view, and remove it afterwards."""
    scene = bpy.data.scenes.new(name)
    camera = create_camera(view.pinhole, scene.collection)
    try:
        for collection in collections:
            scene.collection.children.link(collection)
        scene.camera = camera
        _set_up(scene, view, look)
        yield RenderStage(scene, view, look, folder)
    finally:
        data = camera.data
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(camera)
        bpy.data.cameras.remove(data)


def _set_up(scene: bpy.types.Scene, view: View, look: RenderQuality) -> None:
    render = scene.render
    render.engine = "BLENDER_WORKBENCH"
    render.resolution_x, render.resolution_y = (look.shrink * v for v in view.size)
    aspect = view.K[0, 0] / view.K[1, 1]
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1 / aspect), max(1.0, aspect)
    render.film_transparent = True
    write_targa(scene)
    shading = light_studio(scene, "MATERIAL")
    shading.show_cavity, shading.show_shadows = look.cavity, look.shadows
    if look.cavity:
        shading.cavity_type = "BOTH"
    shading.shadow_intensity = 0.45
    scene.display.light_direction = (0.35, 0.45, 0.82)


def light_studio(scene: bpy.types.Scene, colours: str) -> bpy.types.View3DShading:
    """Light a scene for Workbench, switch off anti-aliasing, and return the scene's shading settings."""
    scene.display.render_aa = "OFF"
    shading = scene.display.shading
    shading.light, shading.color_type = "STUDIO", colours
    if _STUDIO in bpy.context.preferences.studio_lights:
        shading.studio_light = _STUDIO
    return shading


def write_targa(scene: bpy.types.Scene) -> None:
    """Set up a scene to render uncompressed Targa pictures with alpha, in plain sRGB."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format = "TARGA_RAW"
    settings.color_mode = "RGBA"
    scene.render.use_file_extension = True
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"


def render_still(scene: bpy.types.Scene, frame: float, folder: Path) -> np.ndarray:
    """Render a frame of a scene set up by ``write_targa`` as (h, w, 4) uint8 RGBA, top row first."""
    path = folder / "still.tga"
    path.unlink(missing_ok=True)
    scene.render.filepath = str(path)
    go_to_frame(scene, frame)
    # With its own ``scene`` argument, the operator would render the animation in the state of the window's scene.
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        bpy.ops.render.render(write_still=True)
    return read_targa(path)


@dataclass(frozen=True)
class FootageReader:
    """Reads single images from a video or an image sequence, scaled to a given size."""

    scene: bpy.types.Scene  # Scene that renders the footage.
    folder: Path  # Folder for temporary files.
    length: int  # Number of images.
    native_size: tuple[int, int]  # Width and height of the original images in pixels.
    size: tuple[int, int]  # Width and height of the returned images in pixels.

    def image(self, index: int) -> np.ndarray:
        """Return image ``index`` as (h, w, 3) uint8. If the index is too large, return the last image."""
        frame = 1 + min(max(index, 0), self.length - 1)
        return render_still(self.scene, frame, self.folder)[..., :3]


@contextmanager
def open_footage(footage: Footage, size: tuple[int, int], folder: Path) -> Iterator[FootageReader]:
    """Yield a reader that returns the footage scaled to ``size`` (width, height)."""
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
    """Write pictures as an H264 video in an MP4 file. Width and height must be even."""
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
        raise RenderFailed("Blender did not write a video.", where=path.name, hint="Render without a video.")


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
    """Return the list of strips: ``strips`` in Blender 4.4 and later, ``sequences`` before."""
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
    """Return the number of images in a strip, in any Blender version."""
    return int(strip.content_duration if hasattr(strip, "content_duration") else strip.frame_duration)
