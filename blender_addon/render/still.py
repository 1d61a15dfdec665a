"""Rendering one frame of any scene to an array, whatever scene the window shows."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ..conventions.timing import go_to_frame
from .picture import read_targa


def write_targa(scene: bpy.types.Scene) -> None:
    """Make a scene render uncompressed Targa pictures with alpha, in plain sRGB."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format = "TARGA_RAW"
    settings.color_mode = "RGBA"
    scene.render.use_file_extension = True
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"


def render_still(scene: bpy.types.Scene, frame: float, folder: Path) -> np.ndarray:
    """Render one frame of a scene prepared by ``write_targa``: (h, w, 4) uint8 RGBA, top row first.

    Raises:
        RenderFailed: Blender wrote no picture.
    """
    path = folder / "still.tga"
    path.unlink(missing_ok=True)
    scene.render.filepath = str(path)
    go_to_frame(scene, frame)
    # The operator's own ``scene`` argument renders the animation as the window's scene has it.
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        bpy.ops.render.render(write_still=True)
    return read_targa(path)
