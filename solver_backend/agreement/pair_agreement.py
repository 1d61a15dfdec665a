"""How well two views of one person agree, by epipolar lines."""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.detections import MIN_POINTS

OFF_LINE = 0.05
"""A keypoint agrees up to this distance from its epipolar line, in the person's extent: 8 cm of a person."""


def pair_agreement(
    x_a: np.ndarray, R_a: np.ndarray, t_a: np.ndarray, x_b: np.ndarray, R_b: np.ndarray, t_b: np.ndarray,
    off_line: float = OFF_LINE,
) -> float:  # fmt: skip
    """Return the share of two views' keypoints near their epipolar lines and before both cameras; NaN if none is seen.

    Args: those of ``pair_agreements``, of one reading.
    """
    return float(pair_agreements(x_a[None], R_a, t_a, x_b[None], R_b, t_b, off_line)[0])


def pair_agreements(
    x_a: np.ndarray, R_a: np.ndarray, t_a: np.ndarray, x_b: np.ndarray, R_b: np.ndarray, t_b: np.ndarray,
    off_line: float = OFF_LINE,
) -> np.ndarray:  # fmt: skip
    """Return (S,) shares of two views' keypoints near their lines and before both cameras; NaN if none is seen.

    ``E = [t]ₓ R`` with ``x_b = R x_a + t``; the distance of a point from its line is ``|x_bᵀ E x_a| / |(E x_a)₁₂|``,
    and the same the other way (Hartley and Zisserman 2004, sections 9.6 and 11.4).

    Args:
        x_a: (S, F, J, 2) normalised points of the first view in S readings, NaN where unseen; x_b of the second.
        R_a: (3, 3) its rotation from the world; R_b of the second.
        t_a: (3,) its translation; t_b of the second.
        off_line: distance up to which a keypoint agrees, in the person's extent.
    """
    readings = len(x_a)
    shared = np.isfinite(x_a[..., 0]) & np.isfinite(x_b[..., 0])
    enough = shared.sum(-1) >= MIN_POINTS
    if not enough.any():
        return np.full(readings, np.nan)
    of_reading = np.nonzero(enough)[0]
    shared, extent_a, extent_b = shared[enough], _extent(x_a[enough]), _extent(x_b[enough])
    h_a, h_b = _homogeneous(x_a[enough]), _homogeneous(x_b[enough])
    R = R_b @ R_a.T
    t = t_b - R @ t_a
    E = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]]) @ R
    line_b, line_a = E @ h_a, E.T @ h_b
    gap = np.abs((h_b * line_b).sum(0)).reshape(shared.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        near_b = gap / _steepness(line_b, shared.shape) < off_line * extent_b[:, None]
        near_a = gap / _steepness(line_a, shared.shape) < off_line * extent_a[:, None]
        agreeing = near_a & near_b & _ahead(R @ h_a, h_b, t).reshape(shared.shape) & shared
        counts = [np.bincount(of_reading, rows.sum(-1), readings) for rows in (agreeing, shared)]
        return counts[0] / counts[1]


def _homogeneous(x: np.ndarray) -> np.ndarray:
    """Return (3, F J) points (u, v, 1) of (F, J, 2): whole rows of coordinates are what NumPy is fast at."""
    rows = np.ones((3, x.shape[0] * x.shape[1]))
    rows[:2] = x.reshape(-1, 2).T
    return rows


def _steepness(line: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the lengths of lines' first two coordinates, in this shape: what a distance from them is divided by."""
    return np.sqrt((line[:2] ** 2).sum(0)).reshape(shape)


def _ahead(d_a: np.ndarray, d_b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return where rays (3, N) of two cameras meet before both: ``s d_a + t = u d_b``, in the least squares."""
    aa, bb, ab = (d_a * d_a).sum(0), (d_b * d_b).sum(0), (d_a * d_b).sum(0)
    at, bt = t @ d_a, t @ d_b
    spread = aa * bb - ab**2
    return ((ab * bt - bb * at) / spread > 0) & ((aa * bt - ab * at) / spread > 0)


def _extent(x: np.ndarray) -> np.ndarray:
    """Return (F,) the diagonal of a person's box in normalised coordinates, of a person who is seen."""
    along = np.ascontiguousarray(x.transpose(1, 2, 0))  # whole rows of frames again
    size = np.fmax.reduce(along, axis=0) - np.fmin.reduce(along, axis=0)
    return np.hypot(size[0], size[1])
