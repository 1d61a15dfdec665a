"""How steadily points move: accelerations against the truth's, and feet that slide over the floor (thesis 6.3.4)."""

from __future__ import annotations

import numpy as np

from solver_backend.metrics.shapes import has_shape, mean_or_nan, same_shape
from solver_backend.types.shapes import Float

SKATING_HEIGHT_M = 0.025
"""Height below which a toe counts as standing (thesis 6.3.4, H_thr)."""


def accelerations_m_s2(
    points: Float[np.ndarray, "frames points 3"], fps: float
) -> Float[np.ndarray, "accelerations points 3"]:
    """Return the second differences ``(x_{f+1} - 2 x_f + x_{f-1}) fps²`` (thesis 6.3.4).

    Args:
        points: (F, N, 3) metres.
        fps: frames per second.

    Returns:
        (F - 2, N, 3) m/s², NaN where one of the three frames is missing; empty for fewer than three frames.

    Raises:
        ShapeMismatch: the array is not (F, N, 3).
    """
    points = has_shape(points, ("frames", "points", 3))
    return (points[2:] - 2.0 * points[1:-1] + points[:-2]) * fps**2


def accel_error_m_s2(
    found: Float[np.ndarray, "frames points 3"], truth: Float[np.ndarray, "frames points 3"], fps: float
) -> float:
    """Return the mean length of the difference between found and true accelerations, in m/s².

    Args:
        found: (F, N, 3) metres.
        truth: (F, N, 3) metres.
        fps: frames per second.

    Returns:
        m/s²; NaN for fewer than three frames.

    Raises:
        ShapeMismatch: the shapes differ.

    Reference: Kanazawa et al. 2019, "Learning 3D human dynamics from video", sec. 4.
    """
    found, truth = same_shape(found, truth, ("frames", "points", 3))
    difference = accelerations_m_s2(found, fps) - accelerations_m_s2(truth, fps)
    return mean_or_nan(np.linalg.norm(difference, axis=-1))


def foot_skating_cm_per_frame(toes: Float[np.ndarray, "frames toes 3"], floor_m: float = 0.0) -> float:
    """Return how far toes slide along the floor while they stand on it, in centimetres per frame.

    ``FS = 1/N Σ v (2 - 2^(h/H))`` over the frames with ``h ≤ H``, where ``v`` is the horizontal way to the next frame,
    ``h`` the height and ``H`` ``SKATING_HEIGHT_M`` (thesis 6.3.4). The sum is divided by the number of frames, which is
    what its unit (cm/frame) states; a toe below the floor counts as on it.

    Args:
        toes: (F, N, 3) metres, Z up.
        floor_m: height of the floor.

    Returns:
        cm/frame, averaged over the toes; NaN for fewer than two frames.

    Raises:
        ShapeMismatch: the array is not (F, N, 3).

    Reference: Mir et al. 2023, "Generating continual human motion in diverse 3D scenes" (thesis, reference 204).
    """
    toes = has_shape(toes, ("frames", "points", 3))
    way_cm = 100.0 * np.linalg.norm(np.diff(toes[..., :2], axis=0), axis=-1)
    height = np.maximum(toes[:-1, :, 2] - floor_m, 0.0)
    weight = np.where(height <= SKATING_HEIGHT_M, 2.0 - 2.0 ** np.minimum(height / SKATING_HEIGHT_M, 1.0), 0.0)
    return mean_or_nan(np.where(np.isfinite(height), way_cm * weight, np.nan))
