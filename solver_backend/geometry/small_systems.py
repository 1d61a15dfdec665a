"""Systems of three equations, many at a time."""

from __future__ import annotations

import numpy as np

from solver_backend.types.shapes import Float


def solved_3x3(A: Float[np.ndarray, "*batch 3 3"], b: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Return ``A⁻¹ b`` by Cramer's rule, good for matrices near rotations; NaN stays where b has it.

    Args:
        A: (..., 3, 3).
        b: (..., 3).
    """
    rows = [[A[..., i, j] for j in range(3)] for i in range(3)]
    (a, d, g), (e, h, k), (f, i, m) = ([row[j] for row in rows] for j in range(3))
    minors = h * m - k * i, k * f - e * m, e * i - h * f
    determinant = a * minors[0] + d * minors[1] + g * minors[2]
    x, y, z = b[..., 0], b[..., 1], b[..., 2]
    first = x * minors[0] + y * minors[1] + z * minors[2]
    second = a * (y * m - z * i) + d * (z * f - x * m) + g * (x * i - y * f)
    third = a * (h * z - k * y) + d * (k * x - e * z) + g * (e * y - h * x)
    return np.stack([first, second, third], axis=-1) / determinant[..., None]
