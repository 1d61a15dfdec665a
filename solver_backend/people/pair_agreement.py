"""How well two views of one person agree, by epipolar lines."""

from __future__ import annotations

import numpy as np

from solver_backend.people.sightings import MIN_POINTS

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
    x_a, x_b, shared = x_a[enough], x_b[enough], shared[enough]
    extent_a, extent_b = _extent(x_a), _extent(x_b)
    h_a, h_b = (np.concatenate([x, np.ones((*shared.shape, 1))], axis=-1) for x in (x_a, x_b))
    R = R_b @ R_a.T
    t = t_b - R @ t_a
    E = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]]) @ R
    line_b, line_a = h_a @ E.T, h_b @ E
    gap = np.abs((h_b * line_b).sum(-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        near_b = gap / np.linalg.norm(line_b[..., :2], axis=-1) < off_line * extent_b[:, None]
        near_a = gap / np.linalg.norm(line_a[..., :2], axis=-1) < off_line * extent_a[:, None]
        agreeing = near_a & near_b & _ahead(h_a @ R.T, h_b, t) & shared
        counts = [np.bincount(of_reading, rows.sum(-1), readings) for rows in (agreeing, shared)]
        return counts[0] / counts[1]


def _ahead(d_a: np.ndarray, d_b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return where rays of two cameras meet before both: ``s d_a + t = u d_b`` in the second's axes, least squares."""
    aa, bb, ab = (d_a * d_a).sum(-1), (d_b * d_b).sum(-1), (d_a * d_b).sum(-1)
    at, bt = d_a @ t, d_b @ t
    spread = aa * bb - ab**2
    return ((ab * bt - bb * at) / spread > 0) & ((aa * bt - ab * at) / spread > 0)


def _extent(x: np.ndarray) -> np.ndarray:
    """Return (F,) the diagonal of a person's box in normalised coordinates."""
    size = np.nanmax(x, axis=1) - np.nanmin(x, axis=1)
    return np.hypot(size[:, 0], size[:, 1])
