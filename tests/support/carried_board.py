"""A board carried through a ring of cameras, its corners with noise: sightings with a known truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.camera_calibration.boards.board import Board, BoardSighting
from solver_backend.cameras.projection import project
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Cameras

BOARD = Board("charuco", 5, 7, 0.08, 0.06)
LENS = (-0.12, 0.08, 0.0008, -0.0005, 0.0, 0.0, 0.0, 0.0)


def ring(count: int = 4, model: str = "opencv", radius: float = 3.0, lens: Sequence[float] = LENS) -> Cameras:
    """Return cameras on an arc about the origin on its +Y side, 0.6 m up, that look at it."""
    angle = np.radians(np.linspace(40, 140, count) if count > 1 else np.array([90.0]))
    centre = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, 0.6)], axis=1)
    forward = -centre / np.linalg.norm(centre, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    t = -(R @ centre[..., None])[..., 0]
    K = np.tile([[1100.0, 0, 639.5], [0, 1100.0, 359.5], [0, 0, 1]], (count, 1, 1))
    K[:, [0, 1], [0, 1]] += 20.0 * np.arange(count)[:, None]
    names = tuple(f"cam{c + 1}" for c in range(count))
    return Cameras(names, K, np.tile(lens, (count, 1)), R, t, np.tile([1280, 720], (count, 1)), (model,))


def carried(
    cameras: Cameras, moments: int = 40, noise_px: float = 0.15, seed: int = 0, board: Board = BOARD,
    fps: float = 30.0, delays_s: Sequence[float] | None = None,
) -> list[dict[int, BoardSighting]]:  # fmt: skip
    """Return what each camera sees of a board that swings about the middle, facing the cameras' side."""
    rng = np.random.default_rng(seed)
    late = np.zeros(len(cameras)) if delays_s is None else np.asarray(delays_s)
    phase = rng.uniform(0, 2 * np.pi, 6)
    seen: list[dict[int, BoardSighting]] = [{} for _ in cameras.names]
    facing = np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]]).T  # board X, Y, Z in the world: seen from +Y
    for moment in range(moments):
        for c in range(len(cameras)):
            time = moment / fps + late[c]
            swing = np.sin(np.array([2.1, 2.9, 1.7, 2.3, 3.1, 1.9]) * time + phase)
            R = exp_so3(np.array([0.5, 0.5, 0.6]) * swing[:3]) @ facing
            points = (board.points - board.points.mean(0)) @ R.T + np.array([0.5, 0.4, 0.3]) * swing[3:]
            px = project(cameras.subset([c]), points)[0]
            way = points.mean(0) - cameras.centres[c]
            facing_camera = R[:, 2] @ way > 0.35 * np.linalg.norm(way)
            inside = np.isfinite(px).all(-1) & (px > 0).all(-1) & (px < cameras.image_size[c] - 1).all(-1)
            if facing_camera and inside.sum() >= 8:
                noisy = px[inside] + rng.normal(0, noise_px, (int(inside.sum()), 2))
                seen[c][moment] = BoardSighting(np.flatnonzero(inside), noisy, 1.0, 30.0)
    return seen
