"""How far rotations are from where they should be."""

from __future__ import annotations

import numpy as np

from solver_backend.metrics.shapes import mean_or_nan, same_shape
from solver_backend.types.shapes import Float


def geodesic_deg(
    found: Float[np.ndarray, "*batch 3 3"], truth: Float[np.ndarray, "*batch 3 3"]
) -> Float[np.ndarray, " *batch"]:
    """Return the angle of the rotation that leads from one to the other, in degrees.

    ``2 asin(|A - B|_F / (2 √2))``, which keeps its digits for small angles, where the arc cosine of the trace does not.

    Args:
        found: (..., 3, 3) rotations.
        truth: (..., 3, 3) rotations.

    Returns:
        (...) degrees in 0..180, NaN where either is missing.

    Raises:
        ShapeMismatch: the shapes differ.

    Reference: Hartley et al. 2013, "Rotation averaging", sec. 4.
    """
    found, truth = same_shape(found, truth, (..., 3, 3))
    chord = np.linalg.norm(found - truth, axis=(-2, -1)) / np.sqrt(8.0)
    return np.degrees(2.0 * np.arcsin(np.clip(chord, 0.0, 1.0)))


def angle_mae_deg(
    found: Float[np.ndarray, "*batch joints 3 3"], truth: Float[np.ndarray, "*batch joints 3 3"]
) -> float:
    """Return the mean angular error of the kinematic chain (thesis 6.3.4), in degrees.

    Args:
        found: (..., J, 3, 3) rotations of the joints against their parents.
        truth: (..., J, 3, 3) rotations.

    Raises:
        ShapeMismatch: the shapes differ.
    """
    same_shape(found, truth, (..., "joints", 3, 3))
    return mean_or_nan(geodesic_deg(found, truth))
