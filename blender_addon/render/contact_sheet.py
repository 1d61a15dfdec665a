"""The contact sheet: poses through the take from a three-quarter view, and the body in the cameras' views."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from .._exchange.progress import Progress
from .._exchange.unfinished import temporary_folder
from .lettering import Lettering, open_lettering
from .picture import blend, draw_dots, gradient, layer_from_render, write_png
from .stage import RenderQuality, open_stage
from .subject import RenderedTake
from .tiles import GAP, PictureTile, canvas_size, row
from .view import View, close_view, three_quarter_view

POSES, COLUMNS = 12, 6
_POSE_SIZE, _MOST_CAMERA_HEIGHT, _MOST_CAMERAS = (260, 330), 460, 4
_LOOK = RenderQuality(shrink=3, cavity=True, shadows=True)
"""Every tile is rendered three times as large and shrunk; chosen by hand."""
_FOOTAGE_OPACITY = 0.8
"""Opacity of the body over footage; chosen by hand."""
_SHEET_COLOUR = (24, 26, 30)
"""Red, green and blue between the tiles, 0 to 255; chosen by hand."""
_STAGE = "rendering the contact sheet"


def render_contact_sheet(path: Path, subject: RenderedTake, progress: Progress) -> None:
    """Render twelve poses evenly spread over the take and, with a capture, up to four camera views at its middle.

    Args:
        path: the ``.png`` file to write.
        subject: what is pictured.
        progress: called for every picture.

    Raises:
        RenderFailed: Blender cannot render here.
    """
    cameras = subject.cameras(_MOST_CAMERAS)
    poses = [_grid_tile(i) for i in range(POSES)]
    width, poses_height = canvas_size(poses)
    views = row([camera.image_size for camera in cameras], width, _MOST_CAMERA_HEIGHT)
    sheet = np.empty((poses_height + (GAP + views[0].height if views else 0), width, 3), dtype=np.uint8)
    sheet[:] = _SHEET_COLOUR
    total = POSES + len(cameras)
    with temporary_folder() as folder, ExitStack() as stack:
        letters = stack.enter_context(open_lettering(folder, 20))
        frames = np.linspace(0, subject.motion.num_frames - 1, POSES).round().astype(int)
        for i, (frame, tile) in enumerate(zip(frames.tolist(), poses, strict=True)):
            _paste(sheet, _pose_picture(folder, subject, frame, tile, letters), tile)
            progress(_STAGE, i + 1, total)
        for i, (camera, tile) in enumerate(zip(cameras, views, strict=True)):
            view = close_view(camera, subject.joints, (tile.width, tile.height))
            _paste(sheet, _camera_picture(stack, folder, subject, view, letters), tile, poses_height + GAP)
            progress(_STAGE, POSES + i + 1, total)
    write_png(path, sheet)


def _grid_tile(i: int) -> PictureTile:
    width, height = _POSE_SIZE
    return PictureTile(i % COLUMNS * (width + GAP), i // COLUMNS * (height + GAP), width, height)


def _pose_picture(folder: Path, subject: RenderedTake, frame: int, tile: PictureTile, letters: Lettering) -> np.ndarray:
    size = (tile.width, tile.height)
    view = View(three_quarter_view(_around(subject, frame), subject.heading, size), size)
    picture = gradient(*size)
    with open_stage("pose", (subject.take.body, *subject.floor), view, _LOOK, folder) as stage:
        blend(picture, layer_from_render(stage.render(float(subject.times[frame])), _LOOK.shrink), 0, 0)
    letters.write(picture, f"{frame / subject.motion.fps:.2f} s", 8, 8)
    return picture


def _around(subject: RenderedTake, frame: int) -> np.ndarray:
    """Return points to frame: the joints of every pose of the take, moved to where this frame's body is.

    All pictures then have one scale and the body in the middle.
    """
    joints = subject.joints
    middle = (joints.min(axis=1) + joints.max(axis=1)) / 2
    return (joints - middle[:, None] + middle[frame]).reshape(-1, 3)


def _camera_picture(
    stack: ExitStack, folder: Path, subject: RenderedTake, view: View, letters: Lettering
) -> np.ndarray:
    frame = subject.motion.num_frames // 2
    backdrop, is_footage = subject.backdrop(stack, view, folder)
    picture, window = backdrop(frame), view.window(subject.joints[frame])
    if window is not None:
        with open_stage("camera", (subject.take.body,), view, RenderQuality(shrink=3, cavity=True), folder) as stage:
            layer = layer_from_render(stage.render(float(subject.times[frame]), window), stage.look.shrink)
        blend(picture, layer, window[0], window[1], opacity=_FOOTAGE_OPACITY if is_footage else 1.0)
    detections, colour = subject.detections(view)
    draw_dots(picture, detections[frame], max(1.5, view.size[1] / 150), colour)
    letters.write(picture, f"{view.camera.name}  {frame / subject.motion.fps:.2f} s", 8, 8)
    return picture


def _paste(sheet: np.ndarray, picture: np.ndarray, tile: PictureTile, below: int = 0) -> None:
    sheet[tile.y + below : tile.y + below + tile.height, tile.x : tile.x + tile.width] = picture
