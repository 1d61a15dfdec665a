"""Frame rates by the number of pictures: a camera with half as many of the same take recorded half as often.

Short takes show no rate by the search over all offsets (``unlike_views``). Here one reading is tried alone: that all
cameras recorded the same seconds.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from solver_backend.agreement.detections import Detections
from solver_backend.agreement.evidence import BOUND, Evidence
from solver_backend.agreement.reading import Reading
from solver_backend.agreement.resampled import nearest_rows
from solver_backend.types import Cameras

SAME_FRAMES = 2.0
"""By how many frames cameras that record the same seconds differ in their number at most."""
CAMERA_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0)
"""Frames a second that cameras have."""


def rates_by_length(cameras: Cameras, detections: Detections, numbered: Detections) -> np.ndarray:
    """Return (C,) frames of each camera for one of the longest's; ones unless their likelihood is far larger.

    Args:
        cameras: C cameras as written.
        detections: each from its own first frame.
        numbered: the rows that belong together by their numbers.
    """
    as_they_are = np.ones(len(cameras))
    if not detections.lengths:
        return as_they_are
    longest = max(detections.lengths)
    ratios = np.array([_standard(length, longest) for length in detections.lengths])
    if (ratios == 1.0).all():
        return as_they_are
    resampled = nearest_rows(detections, range(len(cameras)), ratios.tolist())
    then, now = (_likelihood(cameras, rows) for rows in (resampled, numbered))
    return ratios if then >= BOUND and then >= now + BOUND else as_they_are


def standard_ratios() -> list[float]:
    """Return the ratios of two rates that cameras have, 1 among them."""
    return sorted({round(a / b, 6) for a, b in product(CAMERA_RATES, CAMERA_RATES) if 0.2 < a / b < 5})


def _standard(length: int, longest: int) -> float:
    """Return the ratio of two rates that cameras have which explains a number of frames, 1 where none does."""
    ratio = min(standard_ratios(), key=lambda ratio: abs(ratio * longest - length))
    return ratio if abs(ratio * longest - length) <= SAME_FRAMES else 1.0


def _likelihood(cameras: Cameras, rows: Detections) -> float:
    evidence, written = Evidence(cameras, rows), Reading.as_written(len(cameras))
    if not evidence.poses:
        return 0.0
    ratio, _ = evidence.likelihoods([written])
    return float(ratio[0]) * evidence.constraints(written) / evidence.design_effect(written)
