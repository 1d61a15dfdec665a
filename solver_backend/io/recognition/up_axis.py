"""The rotation of a source's world by which its up-axis becomes Z."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.errors import JobInvalid
from solver_backend.types import Cameras

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


def with_up_axis(cameras: Cameras, up_axis: str) -> Cameras:
    """Return the cameras in a world rotated so that ``up_axis`` of the old one becomes Z.

    ``x_cam = R x_old + t = (R Aᵀ) x_new + t`` with ``x_new = A x_old``.

    Raises:
        JobInvalid: the axis is unknown.
    """
    return replace(cameras, R=cameras.R @ rotation_to_z_up(up_axis).T)
