"""In which unit and with which axis up points come, where the user gave none: found from the first frames."""

from __future__ import annotations

import numpy as np

from solver_backend.io.recognition.up_axis import rotation_to_z_up
from solver_backend.labelling.outputs import JOINTS, LANDMARKS
from solver_backend.labelling.point_network import PointNetwork

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
AXES = ("z", "y", "x", "-y", "-z", "-x")
_PEOPLE_M = (0.5, 3.5)
"""Reach of a person's markers from end to end."""
_CLEARLY = 0.08
"""An axis other than z is taken only if points are surer by so much."""
_UPRIGHT = 0.1
"""What a person who stands counts for beside that: read from eight recorded takes, whose own axis is surer than the
next by -0.001 to 0.21, and along whose wrong axes the head is at most 0.16 of a trunk above the pelvis."""
_HEAD, _PELVIS = (len(LANDMARKS) - len(JOINTS) + JOINTS.index(name) for name in ("head", "pelvis"))


def unit_of(points: np.ndarray) -> str | None:
    """Return the unit in which (N, 3) points are as large as a person, None if in none."""
    centre = np.median(points, axis=0)
    reach = 2.0 * float(np.quantile(np.linalg.norm(points - centre, axis=-1), 0.9))
    return next((unit for unit, metres in UNITS.items() if _PEOPLE_M[0] < reach * metres < _PEOPLE_M[1]), None)


def up_axis_of(frames: list[np.ndarray], network: PointNetwork) -> str:
    """Return the axis along which the network is surest of what the points are; z unless another is clearly better.

    ``mean p + w max(0, u)``: the points' mean best probability p, and the height u of the head above the pelvis in
    trunk lengths. The network reads people who lie nearly as surely, and people who begin to record stand.
    """
    sure = {}
    for axis in AXES:
        turn = rotation_to_z_up(axis)
        read = [network((points @ turn.T)[None]) for points in frames]
        best = np.mean([np.exp(reading.log_probability[0].max(-1)).mean() for reading in read])
        trunk = np.mean([reading.positions[0, _HEAD] - reading.positions[0, _PELVIS] for reading in read], axis=0)
        sure[axis] = float(best) + _UPRIGHT * max(0.0, float(trunk[2] / np.linalg.norm(trunk)))
    axis = max(sure, key=lambda a: sure[a])
    return axis if sure[axis] > sure["z"] + _CLEARLY else "z"
