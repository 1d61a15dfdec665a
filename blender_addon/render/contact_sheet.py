"""Render a take's contact sheet: poses in a three-quarter view, and camera views."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .._exchange.outputs import temporary_folder
from .._exchange.progress import Progress
from .picture import blend, draw_dots, gradient, layer_from_render, soften_edges, write_png
from .stage import RenderQuality, RenderStage, open_stage, render_still, write_targa
from .subject import Backdrop, Colour, RenderedTake
from .view import View, close_view, three_quarter_view

_ASCENT, _DESCENT = 0.95, 0.35  # Extent of letters above and below the baseline, in font sizes.
_SHRINK = 3  # Letters are rendered larger by this factor and then reduced. Chosen by hand.
_PLAQUE = (0.05, 0.055, 0.065, 0.62)  # Red, green, blue and opacity behind letters. Chosen by hand.


class Lettering:
    """Renders words as layers of ``height`` pixels and caches them."""

    def __init__(self, scene: bpy.types.Scene, text: bpy.types.Object, folder: Path, height: int) -> None:
        self._scene, self._text, self._folder, self._height = scene, text, folder, height
        self._known: dict[str, np.ndarray] = {}

    def write(self, picture: np.ndarray, words: str, x: int, y: int) -> None:
        """Write words on a dark plaque into a picture. The plaque's top left corner is at (x, y)."""
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
    """Yield a renderer of words with lines of ``height`` pixels."""
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


GAP = 4  # Pixels between pictures.


@dataclass(frozen=True)
class PictureTile:
    """Position of a picture in pixels from the top left, and its size, which is even."""

    x: int
    y: int
    width: int
    height: int


def pack(shapes: list[tuple[int, int]], area: tuple[int, int]) -> list[PictureTile]:
    """Arrange (width, height) pictures in rows of equal height that fit into ``area``."""
    if not shapes:
        return []
    choices = [_rows(shapes, rows, area) for rows in range(1, len(shapes) + 1)]
    wanted = area[0] / area[1]

    def misfit(tiles: list[PictureTile]) -> float:
        width, height = canvas_size(tiles)
        return max(width / height / wanted, wanted / (width / height))

    return min(choices, key=misfit)


def row(shapes: list[tuple[int, int]], width: int, most_height: int) -> list[PictureTile]:
    """Arrange pictures in one row that is centred in ``width`` and at most ``most_height`` high."""
    if not shapes:
        return []
    ratio = sum(w / h for w, h in shapes)
    height = min(most_height, int((width - GAP * (len(shapes) - 1)) / ratio))
    tiles = _row(shapes, height, 0)
    left = max(0, (width - tiles[-1].x - tiles[-1].width) // 2)
    return [PictureTile(tile.x + left, 0, tile.width, tile.height) for tile in tiles]


def canvas_size(tiles: list[PictureTile]) -> tuple[int, int]:
    """Return an even width and height that enclose all tiles."""
    width, height = max(t.x + t.width for t in tiles), max(t.y + t.height for t in tiles)
    return width + width % 2, height + height % 2


def _rows(shapes: list[tuple[int, int]], rows: int, area: tuple[int, int]) -> list[PictureTile]:
    per_row = -(-len(shapes) // rows)
    groups = [shapes[i : i + per_row] for i in range(0, len(shapes), per_row)]
    ratios = [sum(w / h for w, h in group) for group in groups]
    # The widest row is ``max(ratios)`` times as wide as it is high, and all rows together have the requested area.
    height = int((area[0] * area[1] / (max(ratios) * len(groups))) ** 0.5)
    tiles = []
    for i, group in enumerate(groups):
        placed = _row(group, height, i * (_even(height) + GAP))
        left = int((max(ratios) - ratios[i]) * height / 2)
        tiles += [PictureTile(tile.x + left, tile.y, tile.width, tile.height) for tile in placed]
    return tiles


def _row(shapes: list[tuple[int, int]], height: int, y: int) -> list[PictureTile]:
    tiles, x = [], 0
    for width, own_height in shapes:
        tiles.append(PictureTile(x, y, _even(height * width / own_height), _even(height)))
        x += tiles[-1].width + GAP
    return tiles


def _even(length: float) -> int:
    return max(2, round(length / 2) * 2)


POSES, COLUMNS = 12, 6
_POSE_SIZE, _MOST_CAMERA_HEIGHT, _MOST_CAMERAS = (260, 330), 460, 4
_LOOK, _CAMERA_LOOK = RenderQuality(3, cavity=True, shadows=True), RenderQuality(3, cavity=True)
"""Tiles are rendered three times as large and then averaged. Chosen by hand."""
_FOOTAGE_OPACITY = 0.8  # Opacity of the body over footage. Chosen by hand.
_SHEET_COLOUR = (24, 26, 30)  # Red, green and blue between the tiles (0 to 255). Chosen by hand.
_STAGE = "rendering the contact sheet"


def render_contact_sheet(path: Path, subject: RenderedTake, progress: Progress) -> None:
    """Render twelve poses of the take, and up to four camera views of its middle frame."""
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
            pane, middle = open_pane(stack, folder, subject, view, tile, _CAMERA_LOOK), subject.motion.num_frames // 2
            words = f"{camera.name}  {middle / subject.motion.fps:.2f} s"
            _paste(sheet, pane.picture(subject, middle, letters, words, 150), tile, poses_height + GAP)
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
    """Return the joints (N, 3) of all poses, moved so that every pose has the centre of this frame's pose."""
    joints = subject.joints
    middle = (joints.min(axis=1) + joints.max(axis=1)) / 2
    return (joints - middle[:, None] + middle[frame]).reshape(-1, 3)


@dataclass(frozen=True)
class Pane:
    """A camera's view inside a picture: the body in front of footage or the floor, with the detections."""

    view: View
    tile: PictureTile
    stage: RenderStage
    backdrop: Backdrop
    opacity: float  # Opacity of the body.
    detections: np.ndarray  # (F, K, 2) pixels in the picture, NaN where unseen.
    dot_colour: Colour

    def picture(self, subject: RenderedTake, frame: int, letters: Lettering, words: str, dots: float) -> np.ndarray:
        """Return a frame's picture with words and detections. The dots' radius is the pane's height / ``dots``."""
        picture, window = self.backdrop(frame), self.view.window(subject.joints[frame])
        if window is not None:
            shrink = self.stage.look.shrink
            layer = layer_from_render(self.stage.render(float(subject.times[frame]), window), shrink)
            layer = soften_edges(layer) if shrink == 1 else layer
            blend(picture, layer, window[0], window[1], opacity=self.opacity)
        draw_dots(picture, self.detections[frame], max(1.5, self.tile.height / dots), self.dot_colour)
        letters.write(picture, words, 8, 8)
        return picture


def open_pane(
    stack: ExitStack, folder: Path, subject: RenderedTake, view: View, tile: PictureTile, look: RenderQuality
) -> Pane:
    """Return a pane that renders a view. The exit stack closes its stage and footage."""
    backdrop, is_footage = subject.backdrop(stack, view, folder)
    stage = stack.enter_context(open_stage("camera", (subject.take.body,), view, look, folder))
    return Pane(view, tile, stage, backdrop, _FOOTAGE_OPACITY if is_footage else 1.0, *subject.detections(view))


def _paste(sheet: np.ndarray, picture: np.ndarray, tile: PictureTile, below: int = 0) -> None:
    sheet[tile.y + below : tile.y + below + tile.height, tile.x : tile.x + tile.width] = picture
