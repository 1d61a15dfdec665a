"""Frame rates by the number of pictures: a camera with half as many of the same take recorded half as often.

Short takes show no rate by the search over all offsets (``unlike_views``). Here one reading is tried alone: that all
cameras recorded the same seconds.
"""

from __future__ import annotations

import numpy as np

from solver_backend.agreement.detections import Detections, main_person, well_seen_frames
from solver_backend.agreement.reading_scores import ReadingScores
from solver_backend.agreement.resampled import nearest_rows
from solver_backend.agreement.unlike_views import standard_ratios
from solver_backend.cameras.camera_corrections import CameraCorrection
from solver_backend.types import Cameras

SAME_FRAMES = 2.0
"""By how many frames cameras that record the same seconds differ in their number at most."""
OFF_LINE, SURE, MARGIN = 0.02, 0.7, 0.08
"""Distance from epipolar lines, in the person's extent, within which so many keypoints must lie, and how many more than
as numbered: takes of the demo of 60 and 90 frames reach 0.83 to 0.89, and 0.39 to 0.77 as numbered."""


def rates_by_length(cameras: Cameras, detections: Detections, numbered: Detections) -> np.ndarray:
    """Return (C,) frames of each camera for one of the longest's; ones where nothing clearly shows other rates.

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
    odd = np.flatnonzero(ratios != 1.0)
    if not len(odd):
        return as_they_are
    then, now = (
        _agreement(cameras, rows, odd)
        for rows in (nearest_rows(detections, range(len(cameras)), ratios.tolist()), numbered)
    )
    return ratios if then >= SURE and then >= now + MARGIN else as_they_are


def _standard(length: int, longest: int) -> float:
    """Return the ratio of two rates that cameras have which explains a number of frames, 1 where none does."""
    ratio = min(standard_ratios(), key=lambda ratio: abs(ratio * longest - length))
    return ratio if abs(ratio * longest - length) <= SAME_FRAMES else 1.0


def _agreement(cameras: Cameras, rows: Detections, chosen: np.ndarray) -> float:
    """Return the least share of keypoints of one of these cameras that agree with the others."""
    xy, confidence = main_person(rows)
    frames = well_seen_frames(confidence)
    scores = ReadingScores(cameras, xy[:, frames], confidence[:, frames], OFF_LINE)
    return min(scores.of_camera(int(c), [CameraCorrection()] * len(cameras)) for c in chosen)
