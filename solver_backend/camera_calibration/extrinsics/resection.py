"""Where a camera stands, from points whose places are known."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.alignment import nearest_rotation
from solver_backend.types.shapes import Float

HYPOTHESES = 300
"""Samples of six points."""
_REFINEMENTS = 5
"""Rounds of reweighting at most; chosen by hand."""


def resected_pose(
    points: Float[np.ndarray, "n 3"], xy: Float[np.ndarray, "n 2"], scale: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"], float]:
    """Return rotation, translation, and the share of points within three scales.

    Samples of six points propose by the direct linear transform, Cauchy's penalty decides, and the best is refined with
    its weights.

    Args:
        points: (n, 3) world, n at least 6, not in one plane.
        xy: (n, 2) normalised.
        scale: distance at which a point loses its weight, normalised units.
        rng: seeded.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 7.1.
    """
    middle = points.mean(0)
    size = float(np.linalg.norm(points - middle, axis=1).mean())
    local = (points - middle) / size
    rows = _rows(local, xy)
    picks = np.stack([rng.permutation(len(points))[:6] for _ in range(HYPOTHESES)])
    found = [_pose(P) for P in np.linalg.svd(rows[picks].reshape(HYPOTHESES, 12, 12))[2][:, -1].reshape(-1, 3, 4)]
    costs = [_cost(pose, local, xy, scale) for pose in found]
    best, cost = found[int(np.argmin(costs))], min(costs)
    for _ in range(_REFINEMENTS):
        distance, depth = _distance(best, local, xy)
        weight = 1.0 / (1.0 + (distance / scale) ** 2) / np.maximum(depth, 1e-3)
        weighted = (rows * weight[:, None, None]).reshape(-1, 12)
        refined = _pose(np.linalg.svd(weighted, full_matrices=False)[2][-1].reshape(3, 4))
        refined_cost = _cost(refined, local, xy, scale)
        if refined_cost >= cost:
            break
        best, cost = refined, refined_cost
    R, t = best
    share = float((_distance(best, local, xy)[0] < 3.0 * scale).mean())
    return R, size * t - R @ middle, share


def _rows(points: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Return (n, 2, 12): both equations of each point in the entries of a camera's (3, 4) matrix."""
    h = np.concatenate([points, np.ones_like(points[:, :1])], axis=1)
    none = np.zeros_like(h)
    across = np.concatenate([h, none, -xy[:, :1] * h], axis=1)
    along = np.concatenate([none, h, -xy[:, 1:] * h], axis=1)
    return np.stack([across, along], axis=1)


def _pose(P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    P = P * np.sign(np.linalg.det(P[:, :3]) or 1.0)
    scale = float(np.linalg.svd(P[:, :3])[1].mean())
    return np.asarray(nearest_rotation(P[:, :3])), P[:, 3] / max(scale, 1e-12)


def _distance(pose: tuple[np.ndarray, np.ndarray], points: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    camera = points @ pose[0].T + pose[1]
    depth = camera[:, 2]
    ahead = depth > 1e-6
    px = camera[:, :2] / np.where(ahead, depth, 1.0)[:, None]
    return np.where(ahead, np.linalg.norm(px - xy, axis=1), 1e3), np.abs(depth)


def _cost(pose: tuple[np.ndarray, np.ndarray], points: np.ndarray, xy: np.ndarray, scale: float) -> float:
    return float(np.log1p((_distance(pose, points, xy)[0] / scale) ** 2).sum())
