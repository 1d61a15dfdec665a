"""The rotation of a source's world by which its up-axis becomes Z."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.errors import JobInvalid

UP_AXES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, -1, 0), (0, 0, 1), (-1, 0, 0)),
}
"""Rotation from a world whose named axis points up to ours, whose Z points up."""


def rotation_to_z_up(up_axis: str) -> np.ndarray:
    """Return the (3, 3) rotation ``A`` with ``x_ours = A @ x_source``.

    Args:
        up_axis: the source's axis that points up: 'z', 'y', '-y' and so on, in any case.

    Raises:
        JobInvalid: the axis is unknown.
    """
    axis = up_axis.lower().lstrip("+")
    if axis not in UP_AXES:
        raise JobInvalid(f"Unknown up axis '{up_axis}'; known are {', '.join(UP_AXES)}.", where="up_axis")
    return np.array(UP_AXES[axis], dtype=np.float64)
