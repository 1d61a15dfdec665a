"""Further recordings that are valid but wrong: a moved camera, frames in a wrong order, exchanged names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.exchange.joint_sets import JointSet
from tests.benchmarks.spoiled_views.kinds import Recording

MOVED_M = (0.2, 0.0, 0.0)  # Movement of a camera after its calibration.
POSTER_PX, POSTER_CONFIDENCE = (300.0, 20.0), 0.9
"""Offset in pixels of a pictured person from the real one, and the detector's confidence for it."""
LEGS = (("left_knee", "right_knee"), ("left_ankle", "right_ankle"))
FOREARMS = (("left_elbow", "left_wrist"),)
"""Pairs of keypoints with exchanged names."""


def moved(recording: Recording, camera: int) -> Recording:
    """Return the recording with one camera away from its calibrated position."""
    cameras = recording.cameras
    t = cameras.t.copy()
    t[camera] -= cameras.R[camera] @ np.array(MOVED_M)
    return replace(recording, cameras=replace(cameras, t=t))


def sorted_as_text(recording: Recording) -> Recording:
    """Return the recording with its frames in the order of their numbers as texts: 0, 1, 10, 100."""
    order = sorted(range(recording.xy.shape[1]), key=str)
    return replace(recording, xy=recording.xy[:, order], confidence=recording.confidence[:, order])


def poster(recording: Recording, camera: int) -> Recording:
    """Return the recording of one camera that detects a picture on the wall for a third of the take."""
    xy, confidence = recording.xy.copy(), recording.confidence.copy()
    third = slice(xy.shape[1] // 3, 2 * xy.shape[1] // 3)
    xy[camera, third], confidence[camera, third] = xy[camera, :1] + POSTER_PX, POSTER_CONFIDENCE
    return replace(recording, xy=xy, confidence=confidence)


def names_exchanged(recording: Recording, pairs: Sequence[tuple[str, str]]) -> Recording:
    """Return the recording with the names of these keypoint pairs exchanged in all views and frames."""
    order = list(range(recording.xy.shape[2]))
    for pair in pairs:
        a, b = (JointSet.BODY_25.keypoints.index(name) for name in pair)
        order[a], order[b] = order[b], order[a]
    return replace(recording, xy=recording.xy[:, :, order], confidence=recording.confidence[:, :, order])


FURTHER_LIES: dict[str, Callable[[Recording, np.random.Generator, int], Recording]] = {
    "one moved 20 cm": lambda r, g, seed: moved(r, int(g.integers(len(r.cameras)))),
    "frames sorted as text": lambda r, g, seed: sorted_as_text(r),
    "a poster for the person": lambda r, g, seed: poster(r, int(g.integers(len(r.cameras)))),
    "lower legs exchanged": lambda r, g, seed: names_exchanged(r, LEGS),
    "elbow and wrist exchanged": lambda r, g, seed: names_exchanged(r, FOREARMS),
}
"""Faults by name. Each function gets a random generator and the seed."""
