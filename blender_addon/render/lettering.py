"""Words on pictures, drawn by Blender's own font."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from .picture import blend, layer_from_render
from .still import render_still, write_targa

_ASCENT, _DESCENT = 0.95, 0.35
"""Reach of letters above and below the line, in font sizes."""
_SHRINK = 3
"""Letters are rendered so many times as large and shrunk; chosen by hand."""
_PLAQUE = (0.05, 0.055, 0.065, 0.62)
"""Red, green, blue and opacity behind letters; chosen by hand."""


class Lettering:
    """Turns words into layers, each word once.

    Args:
        scene: a scene that shows nothing but ``text`` from above.
        text: the text object.
        folder: where pictures may be written.
        height: height of a line in pixels.
    """

    def __init__(self, scene: bpy.types.Scene, text: bpy.types.Object, folder: Path, height: int) -> None:
        self._scene, self._text, self._folder, self._height = scene, text, folder, height
        self._known: dict[str, np.ndarray] = {}

    def write(self, picture: np.ndarray, words: str, x: int, y: int) -> None:
        """Write words on a dark plaque in place, its top left corner at (x, y)."""
        if words and words not in self._known:
            self._known[words] = self._render(words)
        if words:
            blend(picture, self._known[words], x, y)

    def _render(self, words: str) -> np.ndarray:
        self._text.data.body = words
        self._scene.view_layers[0].update()
        unit = self._height / (_ASCENT + _DESCENT)
        width = max(2, round((self._text.dimensions.x + 0.7) * unit))
        render, camera = self._scene.render, self._scene.camera
        render.resolution_x, render.resolution_y = _SHRINK * width, _SHRINK * self._height
        camera.data.ortho_scale = max(width, self._height) / unit
        camera.location = (width / unit / 2 - 0.35, (_ASCENT - _DESCENT) / 2 - 0.02, 1.0)
        alpha = layer_from_render(render_still(self._scene, 1, self._folder), _SHRINK)[..., 3:]
        plaque = np.array([*(c * _PLAQUE[3] for c in _PLAQUE[:3]), _PLAQUE[3]], dtype=np.float32)
        ink = np.array([0.96, 0.96, 0.94, 1.0], dtype=np.float32)
        return (plaque * (1 - alpha) + ink * alpha).astype(np.float32)


@contextmanager
def open_lettering(folder: Path, height: int) -> Iterator[Lettering]:
    """Yield a writer of words whose lines are ``height`` pixels high."""
    scene = bpy.data.scenes.new("letters")
    curve = bpy.data.curves.new("letters", "FONT")
    lens = bpy.data.cameras.new("letters")
    text, camera = bpy.data.objects.new("letters", curve), bpy.data.objects.new("letters", lens)
    try:
        scene.collection.objects.link(text)
        scene.collection.objects.link(camera)
        lens.type = "ORTHO"
        scene.camera = camera
        scene.render.engine = "BLENDER_WORKBENCH"
        scene.render.film_transparent = True
        scene.display.render_aa = "OFF"
        write_targa(scene)
        yield Lettering(scene, text, folder, height)
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(text)
        bpy.data.objects.remove(camera)
        bpy.data.curves.remove(curve)
        bpy.data.cameras.remove(lens)
