"""What lies behind the body: the camera's footage, straightened, or a neutral room with a floor."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import bpy
import numpy as np

from ..bake.distortion import distort, normalised, pixels
from ..bake.footage import Footage
from .picture import blend, gradient, layer_from_render
from .resampling import Resampling
from .stage import Look, open_stage
from .strips import open_footage
from .view import View

Backdrop = Callable[[int], np.ndarray]
"""Returns the (h, w, 3) picture behind the body for a frame of the footage; the caller may draw on it."""

_OUTSIDE = (30, 32, 36)


def floor_backdrop(floor: tuple[bpy.types.Collection, ...], view: View, folder: Path) -> Backdrop:
    """Return a backdrop without footage: a gradient and the floor (if any), rendered once."""
    picture = gradient(*view.size)
    if floor:
        with open_stage("floor", floor, view, Look(shrink=3), folder) as stage:
            blend(picture, layer_from_render(stage.render(1), 3), 0, 0)
    return lambda index: picture.copy()


def footage_backdrop(stack: ExitStack, footage: Footage, view: View, folder: Path) -> Backdrop:
    """Return a backdrop of footage whose lens distortion is taken out.

    Args:
        stack: closes the footage.
        footage: the video or images; their picture is the camera's whole image.
        view: the view.
        folder: where pictures may be written.
    """
    reader = stack.enter_context(open_footage(footage, view.size, folder))
    sources = straightening_map(view)
    if sources is None:
        return lambda index: reader.image(index).copy()
    straighten = Resampling(sources, view.size, _OUTSIDE)
    return lambda index: straighten(reader.image(index))


def straightening_map(view: View) -> np.ndarray | None:
    """Return where in the recorded picture each pixel of the undistorted one comes from: (h, w, 2), None if equal."""
    camera = view.camera
    if camera.distortion_model == "opencv" and not camera.distortion.any():
        return None
    u, v = np.meshgrid(np.arange(view.size[0], dtype=float), np.arange(view.size[1], dtype=float))
    straight = normalised(np.stack([u, v], axis=-1), view.K)
    return pixels(distort(straight, camera.distortion, camera.distortion_model), view.K)
