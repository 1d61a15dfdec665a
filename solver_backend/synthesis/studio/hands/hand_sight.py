"""Which points of a hand a camera sees past the person's body."""

from __future__ import annotations

import numpy as np

from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.hand_points import SIDES
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.body_sight import BodySight, pose_proxy
from solver_backend.synthesis.studio.sight import hidden_by_ellipsoids, sight_lines
from solver_backend.types import Cameras, JointSet

_CHUNK = 32
"""Frames that are looked at together."""


def hidden_points(person: Person, cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """Return (C, F, 2, 21) bool: the body, without the hand itself, stands between a camera and a point.

    Args:
        person: F frames.
        cameras: C cameras.
        points: (F, 2, 21, 3) metres, left first.
    """
    frames, _, count = points.shape[:3]
    sight = BodySight(person.body, person.betas, keypoint_landmarks(person.body, JointSet.COCO_17))
    joints, bone = person.body.layout.joints, sight.proxy.bone
    own = [[j for j, name in enumerate(joints) if name in (f"{s}_wrist", f"{s}_hand")] for s in SIDES]
    counted = np.repeat(np.stack([~np.isin(bone, parts) for parts in own], axis=1), count, axis=1)
    hidden = np.zeros((frames, len(cameras), 2 * count), dtype=bool)
    flat = points.reshape(frames, -1, 3)
    for start in range(0, frames, _CHUNK):
        chunk = slice(start, start + _CHUNK)
        posed = pose_proxy(sight, person, chunk)
        lines = sight_lines(cameras.centres, flat[chunk])
        hidden[chunk] = hidden_by_ellipsoids(cameras.centres, lines, posed.middle, posed.shape, counted)
    return np.swapaxes(hidden, 0, 1).reshape(len(cameras), frames, 2, count)
