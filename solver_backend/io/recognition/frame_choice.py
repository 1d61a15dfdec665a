"""Some frames of a capture, as a capture of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.errors import JobInvalid
from solver_backend.types import Capture, MarkerCloud


def cut_frames(capture: Capture, first: int, last: int) -> Capture:
    """Return the frames ``first`` to ``last`` of a capture, with its truth and its footage.

    Args:
        capture: as it was read.
        first: first frame that is kept, from 0.
        last: last frame that is kept.

    Raises:
        JobInvalid: the take has no such frames.
    """
    count = capture.num_frames
    if not 0 <= first <= last < count:
        raise JobInvalid(
            f"Frames {first} to {last} are not a range of the take of {count} frames.", where="frames",
            hint=f"0 <= first <= last <= {count - 1}.",
        )  # fmt: skip
    stop = last + 1
    keypoints, markers, others = capture.keypoints, capture.markers, capture.others
    people = tuple(replace(p, keypoints=p.keypoints.frames(first, stop)) for p in capture.people)
    footage_first = capture.footage_first or (0,) * len(capture.footage)
    return replace(
        capture,
        keypoints=None if keypoints is None else keypoints.frames(first, stop),
        markers=None if markers is None else _cut_markers(markers, first, stop),
        others=None if others is None else _cut_markers(others, first, stop),
        people=people,
        footage_first=tuple(picture + first for picture in footage_first),
        truth={name: _cut_truth(values, count, first, stop) for name, values in capture.truth.items()},
    )


def _cut_markers(markers: MarkerCloud, first: int, stop: int) -> MarkerCloud:
    residual, covariance = (None if v is None else v[first:stop] for v in (markers.residual, markers.covariance))
    return replace(markers, positions=markers.positions[first:stop], residual=residual, covariance=covariance)


def _cut_truth(values: np.ndarray, count: int, first: int, stop: int) -> np.ndarray:
    """Return truth of these frames: (F, ...) of the world's, or (C, F, ...) of the views'."""
    if values.ndim and len(values) == count:
        return values[first:stop]
    return values[:, first:stop] if values.ndim > 1 and values.shape[1] == count else values
