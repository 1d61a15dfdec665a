"""How fast a board's points move in the pictures, from the frames before and after."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solver_backend.camera_calibration.boards.detection import BoardSighting
from solver_backend.types.shapes import Float


def point_velocities(sightings: Mapping[int, BoardSighting], frame: int, fps: float) -> Float[np.ndarray, "points 2"]:
    """Return (n, 2) px/s of the points seen at a frame: central differences, one-sided where one neighbour is missing.

    A point without neighbours moves like the median of the others; NaN where no frame beside saw the board.

    Args:
        sightings: of one camera, by the frame's number.
        frame: which.
        fps: frames a second.
    """
    here = sightings[frame]
    steps = np.full((2, len(here.ids), 2), np.nan)
    for i, sign in enumerate((-1, 1)):
        beside = sightings.get(frame + sign)
        if beside is not None:
            _, mine, theirs = np.intersect1d(here.ids, beside.ids, return_indices=True)
            steps[i, mine] = sign * (beside.px[theirs] - here.px[mine]) * fps
    known = np.isfinite(steps)
    total = np.where(known, steps, 0.0).sum(0)
    velocity = np.divide(total, known.sum(0), out=np.full_like(total, np.nan), where=known.any(0))
    measured = np.isfinite(velocity).all(-1)
    if measured.any():
        velocity[~measured] = np.median(velocity[measured], axis=0)
    return velocity
