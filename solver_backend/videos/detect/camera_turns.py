"""Estimate how a filming camera turned, from background features tracked through the pictures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver_backend.camera_calibration.pictures import opencv
from solver_backend.cameras.projection import undistort
from solver_backend.cameras.refinement import rotated_back
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.rotations import log_so3
from solver_backend.io.calibration.entry import Calibration
from solver_backend.types import Cameras
from solver_backend.videos.detect.assemble import in_video_pixels
from solver_backend.videos.files.video import probe, read_pictures
from solver_backend.videos.video_detections import VideoDetections

WIDTH_PX = 640
"""Width of the processed pictures. A feature is located to a twentieth of such a pixel."""
FEATURES, FEWEST = 400, 40
"""Number of tracked features, and the fewest. Below half of the first, new features are detected."""
MARGIN = 0.25
"""Margin of people's boxes as a share of their size, because hair, clothes and shadows move with them."""
STILL_DEG = 0.25
"""Largest turn of a still camera in degrees. The noise of the pictures reaches as much over a take."""
LEFT_SHARE, LEFT_PX = 0.15, 1.0
"""Turns explain the background if they leave at most this share of its movement, or this many pixels of 640."""
SCALES_PX = (30.0, 10.0, 3.0, 1.0, 1.0)
"""Scales of Geman and McClure's weights, from least squares to robust estimation."""


@dataclass(frozen=True)
class CameraTurns:
    """Turns of a camera in F pictures."""

    rotations: np.ndarray
    """(F, 3) rotation vectors since the first picture in radians, camera axes."""
    moved_px: float
    """Largest movement of the background, the median of its features, in pixels at a width of 640."""
    left_px: float
    """Largest movement that the turns do not explain, in the same pixels."""

    @property
    def largest_deg(self) -> float:
        """Largest turn from the first picture."""
        return float(np.rad2deg(np.linalg.norm(self.rotations, axis=1)).max(initial=0.0))

    @property
    def explain(self) -> bool:
        """True if the camera was only turned, and not moved or zoomed."""
        return self.left_px <= max(LEFT_PX, LEFT_SHARE * self.moved_px)


def steadied(
    found: tuple[VideoDetections, ...], calibration: Calibration, progress: Progress = silent
) -> tuple[tuple[VideoDetections, ...], list[Diagnostic]]:
    """Return the detections of a single video for a still camera. Several videos are not changed."""
    if len(found) != 1:
        return found, []
    only, (cameras, _) = found[0], in_video_pixels(calibration, found)
    shown = (picture.rgb for picture in read_pictures(probe(only.video)))
    still, diagnostics = as_if_still(only, cameras, shown, progress)
    return (still,), diagnostics


def as_if_still(
    found: VideoDetections, camera: Cameras, pictures: Iterable[np.ndarray], progress: Progress = silent
) -> tuple[VideoDetections, list[Diagnostic]]:
    """Return the detections of one video as if its camera had stayed as in the first picture.

    Args:
        camera: the camera in the video's pixels.
        pictures: (H, W, 3) uint8 in order.
    """
    turns = camera_turns(found, camera, pictures, progress)
    if turns is None:
        return found, [diagnostic("camera_turns", turn="unknown", cameras=[found.name])]
    if turns.largest_deg < STILL_DEG and turns.explain:
        return found, []
    if not turns.explain:
        return found, [diagnostic("camera_moves", cameras=[found.name], moved=turns.moved_px, left=turns.left_px)]

    def back(px: np.ndarray) -> np.ndarray:
        return rotated_back(camera, px.reshape(found.num_frames, -1, 2), turns.rotations).reshape(px.shape)

    hands = found.hands
    if hands is not None:
        hands = hands.copy()
        hands[..., :2] = back(hands[..., :2])
    figures = {"remedy": Remedy.REPAIRED, "size": turns.largest_deg}
    note = diagnostic("camera_turns", turn="measured", cameras=[found.name], **figures)
    return replace(found, xy=back(found.xy), hands=hands), [note]


def camera_turns(
    found: VideoDetections, camera: Cameras, pictures: Iterable[np.ndarray], progress: Progress = silent
) -> CameraTurns | None:
    """Estimate how the camera was turned. Return None if too little background is visible.

    Features are tracked from picture to picture (Lucas and Kanade 1981) until few remain. The turn since their first
    picture is ``min_ω Σ ρ(|d_i - exp(ω) d_i0|)`` over their rays d, and turns are chained.
    """
    cv2 = opencv()
    scale = min(1.0, WIDTH_PX / found.size[0])
    focal = scale * float(np.sqrt(camera.K[0, 0, 0] * camera.K[0, 1, 1]))
    rotations, moved, left = list[np.ndarray](), [0.0], [0.0]
    before, turn, since = None, np.eye(3), np.eye(3)
    points, start_rays = np.zeros((0, 2), np.float32), np.zeros((0, 3))
    for number, rgb in zip(range(found.num_frames), pictures, strict=False):
        grey = cv2.resize(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        if before is not None and len(points):
            points, kept = _followed(cv2, before, grey, points)
            start_rays = start_rays[kept]
            if len(points) < FEWEST:
                return None
            rays = _rays(camera, points / scale)
            step, off = _turn(start_rays, rays, focal)
            turn = step @ since
            moved.append(focal * float(np.median(np.linalg.norm(rays - start_rays, axis=1))))
            left.append(off)
        rotations.append(log_so3(turn))
        if len(points) < FEATURES // 2:
            points = _features(cv2, grey, _free(found, number, grey.shape, scale))
            if len(points) < FEWEST:
                return None
            start_rays, since = _rays(camera, points / scale), turn
        before = grey
        progress("Following the background", number + 1, found.num_frames)
    if not rotations:
        return None
    rotations += rotations[-1:] * (found.num_frames - len(rotations))
    return CameraTurns(np.array(rotations), max(moved), max(left))


def _features(cv2: Any, grey: np.ndarray, mask: np.ndarray) -> np.ndarray:
    corners = cv2.goodFeaturesToTrack(grey, FEATURES, 0.01, 7, mask=mask)
    return np.zeros((0, 2), np.float32) if corners is None else corners[:, 0]


def _followed(cv2: Any, before: np.ndarray, now: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the tracked points, and the mask of points found forwards and backwards."""
    window = {"winSize": (15, 15), "maxLevel": 3}
    onward, there, _ = cv2.calcOpticalFlowPyrLK(before, now, points[:, None], None, **window)
    back, again, _ = cv2.calcOpticalFlowPyrLK(now, before, onward, None, **window)
    kept = (there[:, 0] > 0) & (again[:, 0] > 0) & (np.linalg.norm(back[:, 0] - points, axis=1) < 0.5)
    return onward[kept, 0], kept


def _rays(camera: Cameras, px: np.ndarray) -> np.ndarray:
    """Return (N, 3) unit directions of (N, 2) pixels."""
    n = np.asarray(undistort(camera, px[None].astype(float)))[0]
    rays = np.concatenate([n, np.ones_like(n[:, :1])], axis=1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _turn(before: np.ndarray, now: np.ndarray, focal: float) -> tuple[np.ndarray, float]:
    """Return the robust rotation between rays, and the median distance in px that it leaves.

    Each pass is Kabsch's (1976) solution with Geman and McClure's weights of the last pass.
    """
    R, weight, off = np.eye(3), np.ones(len(now)), np.zeros(len(now))
    for scale in SCALES_PX:
        U, _, Vt = np.linalg.svd((now * weight[:, None]).T @ before)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        off = focal * np.linalg.norm(now - before @ R.T, axis=1)
        weight = (scale**2 / (scale**2 + off**2)) ** 2
    return R, float(np.median(off))


def _free(found: VideoDetections, number: int, shape: tuple[int, ...], scale: float) -> np.ndarray:
    """Return the (H, W) mask of the background without people."""
    mask = np.full(shape, 255, np.uint8)
    for xy, sure in zip(found.xy[number], found.confidence[number], strict=True):
        seen = xy[sure > 0] * scale
        if len(seen) < 2:
            continue
        low, high = seen.min(axis=0), seen.max(axis=0)
        low, high = low - MARGIN * (high - low).max(), high + MARGIN * (high - low).max()
        x0, y0, x1, y1 = np.clip([*low, *high], 0, [shape[1], shape[0]] * 2).astype(int)
        mask[y0:y1, x0:x1] = 0
    return mask
