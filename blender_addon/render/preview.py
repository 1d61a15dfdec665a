"""Render a preview video that shows the body in the cameras' views, over footage or in a plain room."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._exchange.outputs import temporary_folder
from .._exchange.progress import Progress
from ..scene.cameras import find_footage
from .contact_sheet import PictureTile, canvas_size, open_lettering, open_pane, pack
from .picture import write_png
from .stage import RenderQuality, encode_video
from .subject import RenderedTake
from .view import View, close_view, three_quarter_view

_CANVAS_COLOUR = (24, 26, 30)
_LINE = 20
"""Height of a text line in pixels."""


@dataclass(frozen=True)
class PreviewSettings:
    """Size, frame rate and length limits of the preview video."""

    size: tuple[int, int] = (848, 480)  # Width and height in pixels, both even.
    most_fps: float = 30.0  # Faster takes skip frames. Their speed does not change.
    most_frames: int = 360  # Largest number of frames in the video.
    most_views: int = 4  # Largest number of cameras.
    most_footage_pictures: int = 720  # Largest number of footage images to read. If needed, fewer cameras are shown.


def preview_frames(num_frames: int, fps: float, settings: PreviewSettings) -> tuple[list[int], float]:
    """Return the frames of the motion that the video shows, and the frame rate of the video."""
    stride = max(1, int(np.ceil(fps / settings.most_fps - 1e-6)))
    return list(range(0, num_frames, stride))[: settings.most_frames], fps / stride


def render_preview(
    path: Path, subject: RenderedTake, progress: Progress, settings: PreviewSettings | None = None
) -> None:
    """Render a take's preview video in the views of its cameras. Without cameras, use a three-quarter view."""
    settings = settings or PreviewSettings()
    frames, fps = preview_frames(subject.motion.num_frames, subject.motion.fps, settings)
    with temporary_folder() as folder, ExitStack() as stack:
        letters = stack.enter_context(open_lettering(folder, _LINE))
        views, look = _views(subject, settings), RenderQuality(shrink=1)
        panes = [open_pane(stack, folder, subject, view, tile, look) for view, tile in views]
        pictures = []
        size = canvas_size([pane.tile for pane in panes])
        for done, frame in enumerate(frames):
            canvas = np.empty((size[1], size[0], 3), dtype=np.uint8)
            canvas[:] = _CANVAS_COLOUR
            for pane in panes:
                tile, words = pane.tile, pane.view.camera.name
                picture = pane.picture(subject, frame, letters, words, 180)
                canvas[tile.y : tile.y + tile.height, tile.x : tile.x + tile.width] = picture
            letters.write(canvas, f"{frame / subject.motion.fps:.1f} s", 8, size[1] - _LINE - 8)
            pictures.append(folder / f"preview_{done:06d}.png")
            write_png(pictures[-1], canvas, level=1)
            progress("rendering the preview", done + 1, len(frames))
        progress("writing the video", 0, 1)
        encode_video(pictures, size, fps, path)
        progress("writing the video", 1, 1)


def _views(subject: RenderedTake, settings: PreviewSettings) -> list[tuple[View, PictureTile]]:
    cameras = subject.cameras(_view_count(subject, settings))
    if not cameras:
        camera = three_quarter_view(subject.joints.reshape(-1, 3), subject.heading, settings.size)
        return [(View(camera, settings.size), PictureTile(0, 0, *settings.size))]
    tiles = pack([camera.image_size for camera in cameras], settings.size)
    return [
        (close_view(camera, subject.joints, (tile.width, tile.height)), tile)
        for camera, tile in zip(cameras, tiles, strict=True)
    ]


def _view_count(subject: RenderedTake, settings: PreviewSettings) -> int:
    """Return the number of cameras to show. Views with footage are limited, because decoding is slow."""
    cameras = subject.cameras(settings.most_views)
    if not any(find_footage(camera.footage) for camera in cameras):
        return settings.most_views
    frames, _ = preview_frames(subject.motion.num_frames, subject.motion.fps, settings)
    return min(settings.most_views, max(1, settings.most_footage_pictures // len(frames)))
