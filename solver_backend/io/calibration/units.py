"""Length unit of a calibration's world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.io.calibration.entry import CameraEntry
from solver_backend.io.recognition.length_unit import metres_in

WIDEST_ARRAY_M = 60.0
"""Cameras further apart than this many units are not measured in metres."""
OTHER_UNIT, LEAST_FOR_OTHER_UNIT = 20.0, 3
"""Times the distance of the others that one of so many cameras is off where it is written in another unit than they."""
UNIT_ASSUMED = "calibration_unit_assumed"
"""Code of the note on a unit that only the distances between the cameras suggest."""


def in_metres(entries: list[CameraEntry], unit: str | None) -> tuple[list[CameraEntry], Diagnostic, str]:
    """Return the entries in metres, how the unit was found, and the unit where it is guessed, else "".

    Args:
        entries: cameras in the file's unit.
        unit: a key of ``METRES``, or None to infer it from the distances between the cameras: an array wider than
            ``WIDEST_ARRAY_M`` cannot be in metres and is read as millimetres.

    Raises:
        JobInvalid: the unit is unknown.
    """
    guessed = unit is None
    if unit is None:
        width = _rig_width(entries)
        unit = "mm" if width > WIDEST_ARRAY_M else "m"
        note = diagnostic(UNIT_ASSUMED, unit=unit, width=width)
    else:
        note = diagnostic("calibration_unit_stated", unit=unit)
    scale = metres_in(unit)
    metric = [replace(e, t=np.asarray(e.t) * scale) for e in entries]
    return metric, note, unit if guessed else ""


def _rig_width(entries: list[CameraEntry]) -> float:
    centres = np.stack([-np.nan_to_num(e.R).T @ np.nan_to_num(e.t, posinf=0.0, neginf=0.0) for e in entries])
    if len(centres) == 1:
        return float(np.linalg.norm(centres[0]))
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    if len(centres) >= LEAST_FOR_OTHER_UNIT:
        far = int(np.argmax(np.median(apart, axis=1)))
        others = np.delete(np.delete(apart, far, axis=0), far, axis=1)
        if apart.max() > OTHER_UNIT * others.max() > 0:
            return float(others.max())
    return float(apart.max())
