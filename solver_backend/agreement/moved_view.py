"""How well views agree if one camera was turned about itself after it was calibrated, as a knocked tripod is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.agreement.detections import MIN_POINTS
from solver_backend.agreement.reading_scores import ReadingScores, View
from solver_backend.cameras.camera_corrections import CameraCorrection

_ROUNDS = 4
"""Of leaving out what is far off: detectors' outliers are few."""
_FAR = 3.0
"""Times the median angle beyond which a keypoint is left out; chosen by hand."""


def agreement_if_turned(scores: ReadingScores, reading: list[CameraCorrection], c: int) -> float:
    """Return the mean share over pairs of views if camera ``c`` looks where the others see what it sees.

    ``R = argmax sum h . R d`` over rotations, h the camera's unit rays and d the unit directions from its place to the
    points in which the others' rays meet (Kabsch 1976). NaN where they show too little.

    Args:
        scores: of C cameras on few frames.
        reading: (C,) how each is read.
        c: index of the camera.
    """
    views = [scores.view(k, r) for k, r in enumerate(reading)]
    x, R, t = views[c]
    points = meeting_points([view for k, view in enumerate(views) if k != c])
    rays, ways = _unit(np.concatenate([x, np.ones((*x.shape[:2], 1))], axis=-1)), _unit(points + R.T @ t)
    seen = np.isfinite(rays).all(-1) & np.isfinite(ways).all(-1)
    if seen.sum() < MIN_POINTS:
        return float("nan")
    rays, ways = rays[seen], ways[seen]
    near = np.ones(len(rays), bool)
    for _ in range(_ROUNDS):
        R = _rotation(ways[near], rays[near])
        off = np.linalg.norm(rays - ways @ R.T, axis=-1)
        near = off <= _FAR * np.median(off)
    return scores.of_pose(reading, c, R, R @ (views[c][1].T @ t))


def meeting_points(views: Sequence[View]) -> np.ndarray:
    """Return (F, J, 3) points nearest to the rays of two views or more, NaN where fewer see them.

    ``sum (I - d dᵀ) X = sum (I - d dᵀ) C``, least squares.

    Args:
        views: normalised points (F, J, 2), rotation and translation of each.
    """
    left, right, count = 0.0, 0.0, 0
    for x, R, t in views:
        d = _unit(np.concatenate([x, np.ones((*x.shape[:2], 1))], axis=-1)) @ R
        across = np.eye(3) - d[..., :, None] * d[..., None, :]
        seen = np.isfinite(d).all(-1)
        across = np.where(seen[..., None, None], across, 0.0)
        left, right, count = left + across, right + across @ (-R.T @ t), count + seen
    known = np.broadcast_to(np.asarray(count >= 2)[..., None], np.shape(right))
    safe = np.where(known[..., None], left, np.eye(3))
    return np.where(known, np.linalg.solve(safe, np.asarray(right)[..., None])[..., 0], np.nan)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _rotation(sources: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the rotation R that brings sources (N, 3) nearest to targets: ``targets = R sources``."""
    u, _, vh = np.linalg.svd(targets.T @ sources)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vh)]) @ vh
