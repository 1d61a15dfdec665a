"""Fit the pose of a camera that was moved after the calibration to what the other views see."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.body_evidence import triangulate_rays
from solver_backend.agreement.evidence import TakeEvidence
from solver_backend.agreement.noise import LEAST_NOISE
from solver_backend.agreement.reading import Pose, Reading
from solver_backend.geometry.rotations import exp_so3

LEAST_POINTS = 24  # Points that a pose is fitted to at least.
MATERIAL = 0.05  # Median distance in person's sizes by which a camera must see the person elsewhere to count as moved.
AS_FAR = 2.5
"""Times the other views' own distances up to which a fitted pose explains a camera: they made the points themselves."""
_ROUNDS = 15
_ROBUST = 0.03
"""Scale of the Cauchy weights, in person's sizes."""


def refit_pose(evidence: TakeEvidence, reading: Reading, view: int) -> Pose | None:
    """Return the pose of a view that fits the points which the others see, None if it fits as it is or not at all.

    Args:
        evidence: of C >= 3 views.
        reading: how all files are read.
        view: the one that may have been moved.
    """
    others = evidence.without_view(view)
    points, _ = triangulate_rays(others, reading)
    points_key, pose_key = evidence.key(reading, view)
    seen = evidence.points(points_key)
    R, t = evidence.pose_of(pose_key)
    known = np.isfinite(points).all(-1) & np.isfinite(seen.rays).all(-1)
    X, rays = points[known], seen.rays[known]
    if len(X) < LEAST_POINTS:
        return None
    as_written = _distances(R, t, X, rays, seen.size)
    if np.median(as_written) < MATERIAL:
        return None
    starts = [(R, t), _turned(R, t, X, rays)]
    fitted = [_fit(*start, X, rays, seen.size) for start in starts]
    R, t = min(fitted, key=lambda pose: float(np.median(_distances(*pose, X, rays, seen.size))))
    usual = max(_usual_distance(others, reading, view, points), LEAST_NOISE)
    if not np.isfinite(t).all() or np.median(_distances(R, t, X, rays, seen.size)) > AS_FAR * usual:
        return None
    return (*R.ravel().round(9).tolist(), *t.round(9).tolist())


def _usual_distance(others: TakeEvidence, reading: Reading, view: int, points: np.ndarray) -> float:
    """Return the median distance of what the other views see from their points (P, J, 3), in person's sizes."""
    found = list[np.ndarray]()
    for other in range(others.views):
        if other != view:
            points_key, pose_key = others.key(reading, other)
            seen = others.points(points_key)
            known = np.isfinite(points).all(-1) & np.isfinite(seen.rays).all(-1)
            found.append(_distances(*others.pose_of(pose_key), points[known], seen.rays[known], seen.size))
    together = np.concatenate(found)
    return float(np.median(together)) if len(together) else np.inf


def _distances(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray, size: float) -> np.ndarray:
    camera = X @ R.T + t
    ahead = np.where(camera[:, 2] > 1e-6, camera[:, 2], np.nan)
    return np.nan_to_num(np.linalg.norm(camera[:, :2] / ahead[:, None] - rays[:, :2], axis=-1) / size, nan=9.0)


def _turned(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of a camera in its place that looks where the others see what it sees (Kabsch 1976)."""
    place = -R.T @ t
    ways = X - place
    ways /= np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-12)
    seen = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    near = np.ones(len(X), bool)
    turned = R
    for _ in range(4):
        u, _, vh = np.linalg.svd(seen[near].T @ ways[near])
        turned = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vh))]) @ vh
        off = np.linalg.norm(seen - ways @ turned.T, axis=-1)
        near = off <= 3 * np.median(off)
    return turned, -turned @ place


def _fit(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose of least reprojection error with Cauchy weights, by Gauss-Newton."""
    for _ in range(_ROUNDS):
        step = _gauss_newton_step(R, t, X, rays, size)
        R, t = exp_so3(step[:3]) @ R, t + step[3:]
        if np.abs(step).max() < 1e-9:
            break
    return R, t


def _gauss_newton_step(R: np.ndarray, t: np.ndarray, X: np.ndarray, rays: np.ndarray, size: float) -> np.ndarray:
    """Return (6,): a rotation in rad, at most 0.5, and a translation in metres."""
    camera = X @ R.T + t
    z = np.maximum(camera[:, 2], 1e-3 * max(float(np.median(np.abs(camera[:, 2]))), 1e-9))
    x, y = camera[:, 0] / z, camera[:, 1] / z
    off = np.stack([x - rays[:, 0], y - rays[:, 1]], axis=-1) / size
    weight = 1 / (1 + (off**2).sum(-1) / _ROBUST**2)
    zero, inverse = np.zeros_like(x), 1 / z
    by_t = np.stack([np.stack([inverse, zero, -x * inverse], -1), np.stack([zero, inverse, -y * inverse], -1)], 1)
    by_turn = by_t @ -_skew(camera - t)
    J = np.concatenate([by_turn, by_t], axis=-1) / size
    A = np.einsum("n,nia,nib->ab", weight, J, J)
    step = -np.linalg.solve(A + 1e-9 * np.trace(A) * np.eye(6), np.einsum("n,nia,ni->a", weight, J, off))
    return step * min(1.0, 0.5 / max(np.linalg.norm(step[:3]), 1e-12))


def _skew(v: np.ndarray) -> np.ndarray:
    zero = np.zeros(len(v))
    rows = [[zero, -v[:, 2], v[:, 1]], [v[:, 2], zero, -v[:, 0]], [-v[:, 1], v[:, 0], zero]]
    return np.stack([np.stack(row, -1) for row in rows], 1)
