"""Where a prop's solve begins: the shape of its markers, and the pose of every frame that shows three of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.quantiles import quantile
from solver_backend.geometry.quaternions import quat_from_matrix
from solver_backend.geometry.rotations import exp_so3, matrix_from_quat

PASSES = 4
"""Times that poses and shape follow from one another."""
ON_A_LINE_M = 0.01
"""Markers that are nearer than so to one line, root mean square, leave the turn about it open."""
LEAST_SIGMA_M, MOST_SIGMA_M = 3e-4, 5e-3
"""Of a marker per axis: optical systems have 0.1 to 1 mm; where they have more, markers are loose."""


@dataclass(frozen=True)
class PropStart:
    """A prop before its solve."""

    rest: np.ndarray
    """(M, 3) markers about their centre, metres."""
    R: np.ndarray
    """(F, 3, 3)."""
    t: np.ndarray
    """(F, 3) metres."""
    posed: np.ndarray
    """(F,) bool: the frame shows three markers or more; the others lie on the way between such."""
    sigma_m: float
    """Standard deviation of a marker per axis."""


def start_prop(points: np.ndarray) -> PropStart:
    """Return shape and poses of markers that move as one.

    The frame that shows most of them is the first shape; then poses follow from the shape (``umeyama``) and the shape
    from the poses, the median over frames, until both agree.

    Args:
        points: (F, M, 3) metres, NaN where missing; three or more markers.
    """
    seen = np.isfinite(points).all(-1)
    best = int(seen.sum(axis=1).argmax())
    rest = points[best] - points[best][seen[best]].mean(axis=0)
    for _ in range(PASSES):
        R, t, posed = _poses(points, rest)
        own = (points - t[:, None]) @ R
        rest = quantile(np.where(posed[:, None, None], own, np.nan), 0.5, axis=0)
    rest -= rest.mean(axis=0)
    R, t, posed = _poses(points, rest)
    if _on_a_line(rest):
        R = _least_turned(rest, R)
    error = (points - (rest @ np.swapaxes(R, -1, -2) + t[:, None]))[posed]
    sigma = 1.4826 / np.sqrt(_freedom(seen[posed])) * float(quantile(np.abs(error), 0.5, axis=(0, 1, 2)))
    return PropStart(rest, *_between(R, t, posed), posed, min(max(sigma, LEAST_SIGMA_M), MOST_SIGMA_M))


def _poses(points: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return R (F, 3, 3), t (F, 3) and which frames (F,) show three markers of known place."""
    usable = np.isfinite(points).all(-1) & np.isfinite(rest).all(-1)
    posed = usable.sum(axis=1) >= 3
    R, t = np.tile(np.eye(3), (len(points), 1, 1)), np.zeros((len(points), 3))
    shape = np.broadcast_to(rest, points.shape)
    _, R[posed], t[posed] = umeyama(shape[posed], points[posed], usable[posed].astype(np.float64))
    return R, t, posed


def _on_a_line(rest: np.ndarray) -> bool:
    return bool(np.linalg.svd(rest, compute_uv=False)[1] < ON_A_LINE_M * np.sqrt(len(rest)))


def _least_turned(rest: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Return the shortest rotations that lay the markers' line where these lay it."""
    axis = np.linalg.svd(rest)[2][0]
    to = R @ axis
    across, along = np.cross(axis, to), to @ axis
    sine = np.linalg.norm(across, axis=-1)
    angle = np.arctan2(sine, along)
    other = np.linalg.svd(rest)[2][1]
    unit = np.where(sine[:, None] > 1e-9, across / np.maximum(sine, 1e-9)[:, None], other)
    return exp_so3(angle[:, None] * unit)


def _freedom(seen: np.ndarray) -> float:
    """Return the share of the measured numbers that the poses leave free, usually."""
    numbers = 3.0 * float(np.median(seen.sum(axis=1)))
    return (numbers - 6.0) / numbers if numbers > 6.0 else 1.0


def _between(R: np.ndarray, t: np.ndarray, posed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses with those of frames in between: straight lines, of unit quaternions of one sign too."""
    at, frames = np.flatnonzero(posed), np.arange(len(t))
    quat = quat_from_matrix(R[at])
    flip = np.cumprod(np.where((quat[1:] * quat[:-1]).sum(-1) < 0, -1.0, 1.0))
    quat[1:] *= flip[:, None]
    full = np.stack([np.interp(frames, at, quat[:, k]) for k in range(4)], axis=1)
    full /= np.linalg.norm(full, axis=1, keepdims=True)
    return matrix_from_quat(full), np.stack([np.interp(frames, at, t[at, k]) for k in range(3)], axis=1)
