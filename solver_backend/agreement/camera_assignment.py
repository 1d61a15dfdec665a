"""Which calibrated camera each recorded one is, by the agreement of views, where names do not show it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, permutations, product
from math import perm

import numpy as np

from solver_backend.agreement.detections import MIN_CONFIDENCE, Detections, main_person, well_seen_frames
from solver_backend.agreement.pair_agreement import pair_agreement
from solver_backend.cameras.camera_corrections import CameraCorrection, corrected
from solver_backend.cameras.projection import undistort
from solver_backend.types import Cameras

LEAST_CAMERAS = 3
"""Two views agree by chance in too many ways: one pair of lines is all there is."""
MOST_WAYS = 50_000
"""Assignments that are compared: of 8 cameras to 8 there are 40,320."""
SURE, MARGIN = 0.6, 0.2
"""Share of keypoints that must agree, and by how much more than in any other assignment: four real captures reach
0.67 to 0.89 and their next best 0.24 to 0.31; the demo, whose cameras nearly are a ring, 0.90 and 0.58."""
OFF_LINE = 0.03
"""A keypoint agrees up to this distance from its epipolar line, in the person's extent: what nearly fits must not."""
_FRAMES = 20
"""Frames that are compared."""


def assigned_by_views(
    calibrated: Cameras, detections: Detections, by_order: list[int] | None,
    corrections: Sequence[CameraCorrection] | None = None,
) -> list[int] | None:  # fmt: skip
    """Return the calibrated camera of each recorded one under which all views agree, None where none stands out.

    An assignment must reach ``SURE``, and be better than every other by ``MARGIN``;
    rings of cameras alike can be turned without a difference, and then only their order may show which is which.

    Args:
        calibrated: A cameras, in any unit.
        detections: of C recorded ones, C from 3 to A.
        by_order: (C,) the assignment that counting the names suggests, None where they do not count.
        corrections: (C,) how the calibrated camera is read that a recorded one is; None: as written.
    """
    count = len(detections.cameras)
    if not LEAST_CAMERAS <= count <= len(calibrated) or perm(len(calibrated), count) > MOST_WAYS:
        return None
    pairs = _pair_scores(calibrated, detections, corrections or [CameraCorrection()] * count)
    ways = np.array(list(permutations(range(len(calibrated)), count)))
    found = [pairs[i, j][ways[:, i], ways[:, j]] for i in range(count) for j in range(i + 1, count)]
    known = np.isfinite(found)
    scores = np.where(known, found, 0.0).sum(0) / np.maximum(known.sum(0), 1)
    best = int(scores.argmax())
    if by_order is not None:
        ordered = float(scores[(ways == by_order).all(1).argmax()])
        if ordered >= SURE and ordered > scores[best] - MARGIN:
            return by_order
    runner_up = float(np.delete(scores, best).max(initial=0.0))
    clear = scores[best] >= SURE and scores[best] - runner_up >= MARGIN
    return ways[best].tolist() if clear else None


def _pair_scores(calibrated: Cameras, detections: Detections, corrections: Sequence[CameraCorrection]) -> np.ndarray:
    """Return (C, C, A, A) agreement of recorded cameras i < j if they are a and b; NaN where both see nobody."""
    xy, confidence = main_person(detections)
    frames = well_seen_frames(confidence)
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))] if len(frames) else frames
    seen = np.where((confidence >= MIN_CONFIDENCE)[..., None], xy, np.nan)[:, frames]
    count, total = len(xy), len(calibrated)
    read = {correction: corrected(calibrated, [correction] * total) for correction in set(corrections)}
    as_which = [read[correction] for correction in corrections]
    points = [[_normalised(as_which[i], a, seen[i : i + 1]) for a in range(total)] for i in range(count)]
    poses = [list(zip(cameras.R, cameras.t, strict=True)) for cameras in as_which]
    scores = np.full((count, count, total, total), np.nan)
    for (i, j), (a, b) in product(combinations(range(count), 2), permutations(range(total), 2)):
        scores[i, j, a, b] = pair_agreement(points[i][a], *poses[i][a], points[j][b], *poses[j][b], OFF_LINE)
    return scores


def _normalised(cameras: Cameras, a: int, seen: np.ndarray) -> np.ndarray:
    """Return (F, J, 2) normalised points of pixels (1, F, J, 2) if camera a recorded them."""
    return undistort(cameras.subset([a]), seen)[0]
