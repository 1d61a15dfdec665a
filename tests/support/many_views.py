"""The demo's person seen by as many cameras, for as many frames, as a test wants."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Cameras, Capture, Keypoints2D
from tests.support.scenes import look_at

NOISE_PX = 2.0
_SIZE = 1920, 1080
_FOCAL_PX = 1400.0


def ring(count: int, radius: float = 4.5) -> Cameras:
    """Return cameras around the person, at heights from 1 to 3 m."""
    angles = 2 * np.pi * np.arange(count) / count
    heights = 1.0 + 2.0 * (np.arange(count) % 5) / 4
    centres = np.stack([radius * np.cos(angles), radius * np.sin(angles), heights], axis=1)
    R = np.stack([look_at(centre, np.array([0.0, 0.0, 0.9])) for centre in centres])
    K = np.tile(np.array([[_FOCAL_PX, 0, 959.5], [0, _FOCAL_PX, 539.5], [0, 0, 1]]), (count, 1, 1))
    names = tuple(f"cam{c:03d}" for c in range(count))
    return Cameras(names, K, np.zeros((count, 5)), R, -np.einsum("cij,cj->ci", R, centres), np.tile(_SIZE, (count, 1)))


def demo_points() -> np.ndarray:
    """Return (F, K, 3) metres, NaN where unknown: keypoints of the embedded demo as its views show them."""
    demo = demo_capture(360, 60.0)
    cameras, keypoints = demo.require_multiview()
    return triangulate(cameras, keypoints.xy, keypoints.confidence).points


def seen_by(cameras: Cameras, frames: int) -> Capture:
    """Return a capture of so many frames: the demo's person there and back again, by these cameras."""
    points, rng = demo_points(), np.random.default_rng(0)
    at = np.abs((np.arange(frames) + len(points) - 1) % (2 * len(points) - 2) - (len(points) - 1))
    xy = np.stack([_seen(cameras, c, points) for c in range(len(cameras))])[:, at]
    xy = (xy + rng.normal(0.0, NOISE_PX, xy.shape)).astype(np.float32)
    confidence = np.where(np.isfinite(xy).all(-1), 0.85, 0.0)
    joint_set = demo_capture(360, 60.0).require_multiview()[1].joint_set
    return Capture("large", cameras=cameras, keypoints=Keypoints2D(xy, confidence, joint_set, 60.0))


def _seen(cameras: Cameras, c: int, points: np.ndarray) -> np.ndarray:
    return project(cameras.subset([c]), points)[0]
