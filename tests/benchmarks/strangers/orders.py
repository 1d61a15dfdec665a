"""Keypoints in the orders of other datasets and sensors, without names in OpenPose's JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from solver_backend.exchange.joint_sets import JointSet
from tests.benchmarks.strangers.take import COCO, Take, write_openpose, write_rate, write_toml

_BETWEEN = {
    "spine": ("mid_hip", "neck"), "spine_low": ("mid_hip", "mid_hip", "neck"),
    "spine_high": ("mid_hip", "neck", "neck"),
    "head": ("left_ear", "right_ear"), "left_collar": ("neck", "left_shoulder"),
    "right_collar": ("neck", "right_shoulder"), "left_foot": ("left_big_toe",), "right_foot": ("right_big_toe",),
    "left_hand": ("left_wrist",), "right_hand": ("right_wrist",),
}  # fmt: skip
"""Points that BODY_25 lacks, as means of its points."""


def _sides(text: str) -> list[str]:
    """Return the names in a text. A leading ``l.`` or ``r.`` means left or right."""
    sides = {"l": "left_", "r": "right_"}
    return [sides[name[0]] + name[2:] if name[1:2] == "." else name for name in text.split()]


ORDERS: dict[str, Sequence[str]] = {
    "h36m 17": _sides("mid_hip r.hip r.knee r.ankle l.hip l.knee l.ankle spine neck nose head l.shoulder l.elbow "
                      "l.wrist r.shoulder r.elbow r.wrist"),
    "crowdpose 14": _sides("l.shoulder r.shoulder l.elbow r.elbow l.wrist r.wrist l.hip r.hip l.knee r.knee l.ankle "
                           "r.ankle head neck"),
    "lsp 14": _sides("r.ankle r.knee r.hip l.hip l.knee l.ankle r.wrist r.elbow r.shoulder l.shoulder l.elbow l.wrist "
                     "neck head"),
    "mpii 16": _sides("r.ankle r.knee r.hip l.hip l.knee l.ankle mid_hip neck neck head r.wrist r.elbow r.shoulder "
                      "l.shoulder l.elbow l.wrist"),
    "panoptic 19": _sides("neck nose mid_hip l.shoulder l.elbow l.wrist l.hip l.knee l.ankle r.shoulder r.elbow "
                          "r.wrist r.hip r.knee r.ankle l.eye l.ear r.eye r.ear"),
    "smpl 24": _sides("mid_hip l.hip r.hip spine_low l.knee r.knee spine l.ankle r.ankle spine_high l.foot r.foot neck "
                      "l.collar r.collar head l.shoulder r.shoulder l.elbow r.elbow l.wrist r.wrist l.hand r.hand"),
    "kinect 25": _sides("mid_hip spine neck head l.shoulder l.elbow l.wrist l.hand r.shoulder r.elbow r.wrist r.hand "
                        "l.hip l.knee l.ankle l.foot r.hip r.knee r.ankle r.foot spine_high l.hand l.hand r.hand "
                        "r.hand"),
    "azure kinect 32": _sides("mid_hip spine spine_high neck l.collar l.shoulder l.elbow l.wrist l.hand l.hand l.hand "
                              "r.collar r.shoulder r.elbow r.wrist r.hand r.hand r.hand l.hip l.knee l.ankle l.foot "
                              "r.hip r.knee r.ankle r.foot head nose l.eye l.ear r.eye r.ear"),
    "coco and feet 23": [*COCO, *_sides("l.big_toe l.small_toe l.heel r.big_toe r.small_toe r.heel")],
    "ai challenger 14": _sides("r.shoulder r.elbow r.wrist l.shoulder l.elbow l.wrist r.hip r.knee r.ankle l.hip "
                               "l.knee l.ankle head neck"),
    "mediapipe 12": _sides("l.shoulder r.shoulder l.elbow r.elbow l.wrist r.wrist l.hip r.hip l.knee r.knee l.ankle "
                           "r.ankle"),
}  # fmt: skip
"""Orders by dataset and number of points. Those of JTA, PoseTrack and others differ from these by at most one point."""


def in_order(names: Sequence[str], folder: Path, take: Take) -> None:
    """Write keypoints in this order."""
    columns = JointSet.BODY_25.keypoints
    found = [[columns.index(part) for part in _BETWEEN.get(name, (name,))] for name in names]
    points = np.stack([_mean(take.points[:, :, rows]) for rows in found], axis=2)
    for c, name in enumerate(take.names):
        write_openpose(folder, name, [points[c]])
    write_toml(folder, take.cameras)
    write_rate(folder)


def _mean(points: np.ndarray) -> np.ndarray:
    """Return the (C, F, 3) mean of (C, F, N, 3) points, zero if any point is unseen."""
    seen = (points[..., 2] > 0).all(-1, keepdims=True)
    return np.where(seen, points.mean(2), 0.0)


IN_ORDER: dict[str, Callable[[Path, Take], None]] = {name: partial(in_order, names) for name, names in ORDERS.items()}
"""Functions that write a case, by name."""
