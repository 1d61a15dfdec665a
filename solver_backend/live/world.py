"""In which unit and with which axis up points come, where nobody said: told from the first frames."""

from __future__ import annotations

import numpy as np

from solver_backend.io.recognition.up_axis import rotation_to_z_up
from solver_backend.labelling.point_network import PointNetwork

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
AXES = ("z", "y", "x", "-y", "-z", "-x")
_PEOPLE_M = (0.5, 3.5)
"""Reach of a person's markers from end to end."""
_CLEARLY = 0.08
"""An axis other than z is taken only if points are surer by so much."""


def unit_of(points: np.ndarray) -> str | None:
    """Return the unit in which (N, 3) points are as large as a person, None if in none."""
    centre = np.median(points, axis=0)
    reach = 2.0 * float(np.quantile(np.linalg.norm(points - centre, axis=-1), 0.9))
    return next((unit for unit, metres in UNITS.items() if _PEOPLE_M[0] < reach * metres < _PEOPLE_M[1]), None)


def up_axis_of(frames: list[np.ndarray], network: PointNetwork) -> str:
    """Return the axis along which the network is surest of what the points are; z unless another is clearly better."""
    sure = {}
    for axis in AXES:
        turn = rotation_to_z_up(axis)
        best = [network((points @ turn.T)[None]).log_probability[0].max(-1) for points in frames]
        sure[axis] = float(np.mean([np.exp(b).mean() for b in best]))
    axis = max(sure, key=lambda a: sure[a])
    return axis if sure[axis] > sure["z"] + _CLEARLY else "z"
