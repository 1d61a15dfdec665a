"""What lies behind the body: the camera's footage, straightened, or a neutral room with a floor."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import bpy
import numpy as np

from .._exchange.lens import distort, normalised, pixels
from ..scene.footage import Footage
from .picture import blend, gradient, layer_from_render
from .resampling import Resampling
from .stage import RenderQuality, open_stage
from .strips import open_footage
from .view import View

Backdrop = Callable[[int], np.ndarray]
"""Returns the (h, w, 3) picture behind the body for a frame of the footage; the caller may draw on it."""

_OUTSIDE = (30, 32, 36)
_CUT = 0.02
"""Largest share by which footage may differ from the calibrated size and still be taken to be cut off."""


def floor_backdrop(floor: tuple[bpy.types.Collection, ...], view: View, folder: Path) -> Backdrop:
    """Return a backdrop without footage: a gradient and the floor (if any), rendered once."""
    picture = gradient(*view.size)
    if floor:
        with open_stage("floor", floor, view, RenderQuality(shrink=3), folder) as stage:
            blend(picture, layer_from_render(stage.render(1), 3), 0, 0)
    return lambda index: picture.copy()


def footage_backdrop(stack: ExitStack, footage: Footage, view: View, folder: Path) -> Backdrop:
    """Return a backdrop of footage whose lens distortion is taken out.

    Args:
        stack: closes the footage.
        footage: the video or images.
        view: the view.
        folder: where pictures may be written.
    """
    whole = np.round(np.array(view.camera.image_size) * view.scale).astype(int)
    reader = stack.enter_context(open_footage(footage, (int(whole[0]), int(whole[1])), folder))
    positions = straightening_map(view, reader.native_size, reader.size)
    if positions is None:
        return lambda index: reader.image(index).copy()
    straighten = Resampling(positions, reader.size, _OUTSIDE)
    return lambda index: straighten(reader.image(index))


def straightening_map(view: View, native_size: tuple[int, int], read_size: tuple[int, int]) -> np.ndarray | None:
    """Return where in the footage each pixel of the undistorted picture comes from.

    Footage of nearly the calibrated size is taken to be cut off at its right and bottom, as codecs do that pad to
    multiples of 16 pixels; footage of any other size is taken to be the whole image, scaled.

    Args:
        view: the view.
        native_size: width and height of the footage's own images.
        read_size: width and height to which they are scaled when read.

    Returns:
        (h, w, 2) pixels of the scaled footage, or None if every pixel comes from where it is.
    """
    camera, calibrated = view.camera, np.array(view.camera.image_size)
    scale = calibrated / np.array(native_size)
    cut = bool((np.abs(scale - 1) < _CUT).all() and (scale != 1).any())
    bent = bool(camera.distortion.any()) or camera.distortion_model != "opencv"
    if not (cut or bent) and view.part[2] == 1.0 and read_size == view.size:
        return None
    u, v = np.meshgrid(np.arange(view.size[0], dtype=float), np.arange(view.size[1], dtype=float))
    straight = normalised(np.stack([u, v], axis=-1), view.K)
    seen = pixels(distort(straight, camera.distortion, camera.distortion_model), camera.K)
    covered = np.array(native_size) if cut else calibrated
    return (seen + 0.5) * np.array(read_size) / covered - 0.5
