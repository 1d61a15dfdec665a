"""Convert the detections of a moving camera to a level camera that pans slowly with the person."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.cameras.projection import project, undistort
from solver_backend.exchange.lens import DEFAULT_MODEL
from solver_backend.exchange.plausible import FARTHEST_PX
from solver_backend.geometry.interpolation import smooth
from solver_backend.geometry.small_matrices import unit
from solver_backend.types import Cameras, Keypoints2D

FOLLOWS_S = 1.0  # Standard deviation in seconds of the Gaussian that smooths the person's direction over time. By hand.


def steady_camera(camera: Cameras, keypoints: Keypoints2D) -> tuple[Cameras, Keypoints2D]:
    """Convert a moving camera and its detections to a level camera that pans slowly with the person.

    The view lifter was trained on static cameras, and the detector noise is measured from track jitter. A shaking
    camera would disturb lifter and noise. The level camera is at the same place, so no depth is needed:
    ``x' = π(V Rᵀ π⁻¹(x))``. R is the rotation of the moving camera, V is the rotation of the level camera, and π is the
    projection. A static camera is unchanged.

    Args:
        camera: a single camera, in a world with Z up.
        keypoints: detections of the camera.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 8.4 (cameras that share a centre).
    """
    if camera.path is None:
        return camera, keypoints
    R, t = camera.poses(0, keypoints.num_frames)
    level = replace(camera, distortion=np.zeros((1, 8)), models=(DEFAULT_MODEL,), path=None)
    origin = replace(level, R=np.eye(3)[None], t=np.zeros((1, 3)))

    def rays(px: np.ndarray) -> np.ndarray:
        n = np.asarray(undistort(camera, px[None]))[0]
        return np.einsum("f...a,fab->f...b", np.concatenate([n, np.ones_like(n[..., :1])], axis=-1), R)

    V = _panning(np.nansum(unit(rays(keypoints.xy[0])), axis=1)[:, :2], keypoints.fps)

    def turned(px: np.ndarray) -> np.ndarray:
        found = np.asarray(project(origin, np.einsum("fab,f...b->f...a", V, rays(px))))[0]
        return np.where(np.abs(found).max(axis=-1, keepdims=True) < FARTHEST_PX, found, np.nan)

    hands = keypoints.hands
    if hands is not None:
        hands = np.concatenate([turned(hands[0, ..., :2]), hands[0, ..., 2:]], axis=-1)[None]
    centres = -np.einsum("fba,fb->fa", R, t)
    seen = replace(keypoints, xy=turned(keypoints.xy[0])[None], hands=hands)
    return level.carried(V, -np.einsum("fab,fb->fa", V, centres)), seen


def _panning(way: np.ndarray, fps: float) -> np.ndarray:
    """Return rotations (F, 3, 3) of a level camera that smoothly follows horizontal directions (F, 2).

    A direction of zero length is unknown.
    """
    known = np.flatnonzero(np.linalg.norm(way, axis=1) > 0)
    known = known if len(known) else np.arange(len(way))
    heading = np.unwrap(np.arctan2(way[known, 1], way[known, 0]))
    heading = smooth(np.interp(np.arange(len(way)), known, heading)[:, None], FOLLOWS_S * fps)[:, 0]
    c, s, zero = np.cos(heading), np.sin(heading), np.zeros(len(way))
    return np.stack([np.stack(row, axis=1) for row in ((s, -c, zero), (zero, zero, zero - 1.0), (c, s, zero))], axis=1)
