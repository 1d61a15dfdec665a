"""How cameras fit a take, measured where calibrations are made and shown by reports."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROWS, COLUMNS = ("top", "centre", "bottom"), ("left", "middle", "right")
"""Parts of a picture."""


@dataclass(frozen=True)
class CameraFits:
    """How C cameras fit one take; px unless stated."""

    verdict: str
    """One sentence."""
    region_px: np.ndarray
    """(C, 3, 3) median reprojection error by part of the picture, rows first; NaN where too little was seen."""
    camera_px: np.ndarray
    """(C,) the same of the whole picture."""
    best_px: np.ndarray
    """(C,) the same after the poses were adjusted to the take."""
    epipolar_px: np.ndarray
    """(C, W) median distance to the other cameras' epipolar lines in W equal stretches of the take."""
    stature_m: float
    """Of the person by the calibration's scale, metres."""
    tilt_deg: float
    """Between the world's up and the person's, degrees."""
    tilt_sigma_deg: float
    """Standard deviation of that angle as a person shows it, degrees."""
    findings: tuple[str, ...]
    """What is wrong, with what to do."""
