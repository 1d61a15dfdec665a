"""How far points are from where they should be: MPJPE, its aligned form, RMSE and PCK (thesis 6.3.4)."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.alignment import umeyama
from solver_backend.metrics.shapes import mean_or_nan, same_shape
from solver_backend.types.shapes import Float

POINTS = (..., "points", 3)
"""Shape of what is compared, metres."""


def distances_m(
    found: Float[np.ndarray, "*batch points 3"], truth: Float[np.ndarray, "*batch points 3"]
) -> Float[np.ndarray, "*batch points"]:
    """Return the distance of every point to its truth, NaN where either is missing.

    Args:
        found: (..., N, 3) metres.
        truth: (..., N, 3) metres, of the very same shape.

    Returns:
        (..., N) metres.

    Raises:
        ShapeMismatch: the shapes differ.
    """
    found, truth = same_shape(found, truth, POINTS)
    return np.linalg.norm(found - truth, axis=-1)


def mpjpe_mm(found: Float[np.ndarray, "*batch points 3"], truth: Float[np.ndarray, "*batch points 3"]) -> float:
    """Return the mean per-joint position error without any alignment, in millimetres.

    ``mean |found - truth|`` over all points that both have; NaN if there is none.

    Args:
        found: (..., N, 3) metres.
        truth: (..., N, 3) metres.

    Raises:
        ShapeMismatch: the shapes differ.

    Reference: Ionescu et al. 2014, "Human3.6M", sec. 3.
    """
    return 1000.0 * mean_or_nan(distances_m(found, truth))


def rmse_mm(found: Float[np.ndarray, "*batch points 3"], truth: Float[np.ndarray, "*batch points 3"]) -> float:
    """Return the mean over samples of the root of the mean squared distance, without alignment, in millimetres.

    ``1/N Σ_i √(1/J Σ_j |found_ij - truth_ij|²)``, a sample being a frame. Eq. 4.28 prints the norm without its square,
    which would have no unit of length. A sample without any point in common takes no part.

    Args:
        found: (..., J, 3) metres, N samples of J points.
        truth: (..., J, 3) metres.

    Raises:
        ShapeMismatch: the shapes differ.

    Reference: thesis eq. 4.28.
    """
    squared = distances_m(found, truth) ** 2
    known = np.isfinite(squared)
    count = known.sum(axis=-1)
    some = count > 0
    samples = np.where(known, squared, 0.0).sum(axis=-1)[some] / count[some]
    return 1000.0 * mean_or_nan(np.sqrt(samples))


def pa_mpjpe_mm(found: Float[np.ndarray, "*batch points 3"], truth: Float[np.ndarray, "*batch points 3"]) -> float:
    """Return the MPJPE after each frame is aligned to its truth by the best similarity (scale, rotation, translation).

    Points that either side lacks take no part; frames with fewer than three common points are left out.

    Args:
        found: (..., N, 3) metres.
        truth: (..., N, 3) metres.

    Raises:
        ShapeMismatch: the shapes differ.

    Reference: Umeyama 1991.
    """
    found, truth = same_shape(found, truth, POINTS)
    found, truth = found.reshape(-1, *found.shape[-2:]), truth.reshape(-1, *truth.shape[-2:])
    both = np.isfinite(found).all(-1) & np.isfinite(truth).all(-1)
    enough = both.sum(-1) >= 3
    if not enough.any():
        return float("nan")
    found, truth, both = found[enough], truth[enough], both[enough]
    scale, R, t = umeyama(found, truth, both.astype(np.float64), with_scale=True)
    aligned = scale[:, None, None] * (found @ np.swapaxes(R, -1, -2)) + t[:, None, :]
    return 1000.0 * mean_or_nan(np.where(both, np.linalg.norm(aligned - truth, axis=-1), np.nan))


def pck_percent(
    found: Float[np.ndarray, "*batch points 3"], truth: Float[np.ndarray, "*batch points 3"], threshold_m: float
) -> float:
    """Return the share of points within ``threshold_m`` of their truth, in percent, without alignment.

    A point that was not found though its truth is known counts as wrong; points without truth take no part. The
    thesis reports 3 cm and 7 cm.

    Args:
        found: (..., N, 3) metres.
        truth: (..., N, 3) metres.
        threshold_m: metres.

    Raises:
        ShapeMismatch: the shapes differ.

    Reference: Yang and Ramanan 2013, "Articulated human detection with flexible mixtures of parts"; thesis
        6.3.4, eq. 4.29.
    """
    distance = distances_m(found, truth)
    known = np.isfinite(truth).all(-1)
    return 100.0 * float((distance[known] <= threshold_m).mean()) if known.any() else float("nan")
