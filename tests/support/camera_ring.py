"""Cameras around a volume, and what they detect of random points in it."""

from __future__ import annotations

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.types import Cameras


def ring(count: int, model: str = "opencv", arc: float = 2 * np.pi) -> Cameras:
    """Return cameras 4 m around the origin that look at a height of 1 m."""
    angle = np.arange(count) * arc / count + 0.3
    centre = np.stack([4 * np.cos(angle), 4 * np.sin(angle), 1.5 + 0.4 * np.sin(3 * angle)], -1)
    forward = np.array([0, 0, 1.0]) - centre
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], 1)
    t = -(R @ centre[..., None])[..., 0]
    K = np.tile([[1100.0, 0, 960], [0, 1100, 540], [0, 0, 1]], (count, 1, 1))
    lens = [-0.1, 0.02, 1e-3, 0, 0, 0, 0, 0] if model == "opencv" else [-0.02, 0.01, 0, 0, 0, 0, 0, 0]
    names = tuple(f"camera{i}" for i in range(count))
    return Cameras(names, K, np.tile(lens, (count, 1)), R, t, np.tile([1920, 1080], (count, 1)), (model,))


def record(cameras: Cameras, frames: int, keypoints: int, sigma: float, seed: int = 0):
    """Return true points (F, K, 3), detections (C, F, K, 2) and confidences (C, F, K)."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.8, -0.8, 0], [0.8, 0.8, 1.8], (frames, keypoints, 3))
    px = project(cameras, points)
    return points, px + sigma * rng.normal(size=px.shape), rng.uniform(0.3, 1.0, px.shape[:-1])
