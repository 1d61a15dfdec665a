"""Contents of a preview: the take, its detections, and the floor or the footage behind the body."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from .._exchange.capture_file import CameraFile, CaptureFile
from .._exchange.lens import distort, is_pinhole, normalised, pixels
from .._exchange.motion_file import MotionFile
from .._exchange.so3 import matrix_from_rotvec
from ..body.body_file import BodyFile, pose_joints, rotvec_on
from ..conventions.skeleton import SMPL
from ..scene.bake import BakedTake
from ..scene.cameras import Footage, find_footage
from .picture import Resampling, blend, gradient, layer_from_render
from .stage import RenderQuality, open_footage, open_stage
from .view import View

Backdrop = Callable[[int], np.ndarray]  # Returns a new (h, w, 3) background picture for a footage frame.

_OUTSIDE = (30, 32, 36)
_CUT = 0.02
"""Largest relative difference between the sizes of footage that was only cropped and of the calibrated image."""


def floor_backdrop(floor: tuple[bpy.types.Collection, ...], view: View, folder: Path) -> Backdrop:
    """Return a backdrop that needs no footage: a gradient and, if given, the floor. It is rendered once."""
    picture = gradient(*view.size)
    if floor:
        with open_stage("floor", floor, view, RenderQuality(shrink=3), folder) as stage:
            blend(picture, layer_from_render(stage.render(1), 3), 0, 0)
    return lambda index: picture.copy()


def footage_backdrop(stack: ExitStack, footage: Footage, view: View, folder: Path) -> Backdrop:
    """Return a backdrop that shows undistorted footage. The exit stack closes the footage."""
    whole = np.round(np.array(view.camera.image_size) * view.scale).astype(int)
    reader = stack.enter_context(open_footage(footage, (int(whole[0]), int(whole[1])), folder))
    positions = straightening_map(view, reader.native_size, reader.size)
    if positions is None:
        return lambda index: reader.image(index).copy()
    straighten = Resampling(positions, reader.size, _OUTSIDE)
    return lambda index: straighten(reader.image(index))


def straightening_map(view: View, native_size: tuple[int, int], read_size: tuple[int, int]) -> np.ndarray | None:
    """Return the position (h, w, 2) of each undistorted pixel in the scaled footage, or None if no pixel moves.

    Footage of almost the calibrated size is treated as cropped at the right and bottom, because codecs pad there to
    multiples of 16 pixels. Footage of any other size is treated as the whole image, scaled.
    """
    camera, calibrated = view.camera, np.array(view.camera.image_size)
    scale = calibrated / np.array(native_size)
    cut = bool((np.abs(scale - 1) < _CUT).all() and (scale != 1).any())
    bent = not is_pinhole(camera.distortion, camera.distortion_model)
    if not (cut or bent) and view.part[2] == 1.0 and read_size == view.size:
        return None
    u, v = np.meshgrid(np.arange(view.size[0], dtype=float), np.arange(view.size[1], dtype=float))
    straight = normalised(np.stack([u, v], axis=-1), view.K)
    seen = pixels(distort(straight, camera.distortion, camera.distortion_model), camera.K)
    covered = np.array(native_size) if cut else calibrated
    return (seen + 0.5) * np.array(read_size) / covered - 0.5


Colour = tuple[float, float, float]  # sRGB, 0 to 1.

DETECTION_DOT: Colour = (1.0, 0.62, 0.12)
KEYPOINT_DOT: Colour = (0.25, 0.95, 0.65)
MARKER_DOT: Colour = (0.92, 0.92, 0.96)
"""Colours of detection dots in sRGB. Chosen by hand."""


@dataclass(frozen=True)
class RenderedTake:
    """A baked take of F frames to render, with its motion, body and capture."""

    take: BakedTake
    motion: MotionFile
    body: BodyFile
    capture: CaptureFile | None = None
    joints: np.ndarray = field(init=False)  # (F, 24, 3) joints of the baked body in world metres.
    times: np.ndarray = field(init=False)  # (F,) scene frames.

    def __post_init__(self) -> None:
        motion = self.motion
        layout = self.body.layout
        _, joints = pose_joints(self.body.rest_joints(motion.betas), rotvec_on(motion, layout), motion.transl)
        object.__setattr__(self, "joints", joints[:, list(layout.standing_for(SMPL))])
        object.__setattr__(self, "times", self.take.timing.scene_frames(motion.num_frames, motion.fps))

    @property
    def floor(self) -> tuple[bpy.types.Collection, ...]:
        """Collections that contain the floor, or an empty tuple without a floor."""
        return () if self.take.floor is None else tuple(self.take.floor.users_collection)

    @property
    def heading(self) -> float:
        """Heading of the body in the first frame: the angle about Z from +X, in radians."""
        forward = matrix_from_rotvec(self.motion.rotvec[0, 0])[:, 2]
        return float(np.arctan2(forward[1], forward[0]))

    def cameras(self, most: int) -> tuple[CameraFile, ...]:
        """Return up to ``most`` cameras, at equal intervals in the capture's list."""
        if self.capture is None or not self.capture.cameras:
            return ()
        cameras = self.capture.cameras
        chosen = np.linspace(0, len(cameras) - 1, min(most, len(cameras))).round().astype(int)
        return tuple(cameras[i] for i in chosen)

    def backdrop(self, stack: ExitStack, view: View, folder: Path) -> tuple[Backdrop, bool]:
        """Return a view's backdrop, and whether it shows footage."""
        footage = find_footage(view.camera.footage)
        if footage is not None:
            return footage_backdrop(stack, footage, view, folder), True
        return floor_backdrop(self.floor, view, folder), False

    def detections(self, view: View) -> tuple[np.ndarray, Colour]:
        """Return the pixels (F, K, 2) of a view's detections or projected points, and their colour."""
        frames, capture = self.motion.num_frames, self.capture
        if capture is not None and capture.xy is not None and view.camera in capture.cameras:
            xy = capture.xy[capture.cameras.index(view.camera)]
            return view.from_detections(self._by_frame(xy, capture.fps)), DETECTION_DOT
        if capture is not None and capture.markers is not None:
            return view.project(self._by_frame(capture.markers, capture.fps))[0], MARKER_DOT
        if self.motion.keypoints3d is not None:
            return view.project(self.motion.keypoints3d)[0], KEYPOINT_DOT
        return np.zeros((frames, 0, 2)), KEYPOINT_DOT

    def _by_frame(self, rows: np.ndarray, fps: float) -> np.ndarray:
        at = np.round(np.arange(self.motion.num_frames) * fps / self.motion.fps).astype(int)
        shown = np.full((len(at), *rows.shape[1:]), np.nan)
        shown[at < len(rows)] = rows[at[at < len(rows)]]
        return shown
