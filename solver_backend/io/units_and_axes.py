"""Convert length units and up axes to metres with Z up."""

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
"""Rotation from a world with the named up axis to our world with Z up, by rows."""


def rotation_to_z_up(up_axis: str) -> np.ndarray:
    """Return the (3, 3) rotation ``A`` from a world with an up axis such as '-y': ``x_z_up = A @ x``."""
    axis = up_axis.lower().lstrip("+")
    if axis not in UP_AXES:
        raise JobInvalid(f"Unknown up axis '{up_axis}'. Known axes: {', '.join(UP_AXES)}.", where="up_axis")
    return np.array(UP_AXES[axis], dtype=np.float64)


def with_up_axis(cameras: Cameras, up_axis: str) -> Cameras:
    """Rotate the world of the cameras so that its up axis becomes Z.

    ``x_cam = R x_old + t = (R Aᵀ) x_new + t`` with ``x_new = A x_old``.
    """
    return replace(cameras, R=cameras.R @ rotation_to_z_up(up_axis).T)


METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}  # Metres per unit.
_STARTS = {"mm": "mm", "mil": "mm", "cm": "cm", "cen": "cm", "m": "m", "met": "m", "in": "inch", "f": "foot"}
"""Unit by the first letters of its name. Files contain mm, Millimeters, METERS, mete, m, inches, ft."""


def metres_in(unit: str) -> float:
    """Return the number of metres in a length unit.

    Raises:
        JobInvalid: the unit is unknown.
    """
    if unit not in METRES:
        hint = "For any other unit, such as squares of a board, specify its length in metres with --scale."
        raise JobInvalid(f"Unknown unit '{unit}'. Known units: {', '.join(METRES)}.", where="unit", hint=hint)
    return METRES[unit]


def unit_named(text: str) -> str | None:
    """Return the key of ``METRES`` for a unit name in a file, or None if it is unknown."""
    word = text.strip().lower()
    if word in METRES:
        return word
    starts = [start for start in _STARTS if word.startswith(start)]
    return _STARTS[max(starts, key=len)] if starts else None
