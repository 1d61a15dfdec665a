"""A motion as its own measurement: what there is to go by where nobody has the recording it was solved from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.measurements.landmarks import measure_landmarks
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.geometry.arrays import Array, constant
from solver_backend.types import JointSet, Motion

SIGMA_M = 0.02
"""How far a pose may stray from the motion's: a hand-set pose beside it counts for more."""
YIELDING_S = 0.25
"""So long before and after a pinned pose nothing is measured: there the earlier motion was wrong."""
_LANDMARKS = JointSet.HALPE_26


def measure_motion(body: Body, motion: Motion, pinned: Sequence[int], like: Array) -> Measurements:
    """Return the motion's own body points as measurements, but for the frames about a pinned one.

    Args:
        body: the body the motion is of.
        motion: F frames.
        pinned: frames whose poses somebody set.
        like: array that sets kind, type and device.

    Raises:
        MotionInvalid: the motion is of another body or layout.
    """
    motion.require_body(body.id, body.layout.recorded, where="resolve")
    landmarks = keypoint_landmarks(body, _LANDMARKS)
    poses = PosedFrames.of_motion(motion, motion.transl)
    points = pose_landmarks(body, landmarks, motion.betas, poses.root, poses.local, poses.transl).points
    frames, reach = np.arange(motion.num_frames), YIELDING_S * motion.fps
    doubted = (np.abs(frames[:, None] - np.array(pinned, dtype=int)[None]) < reach).any(axis=1)
    measured = measure_landmarks(landmarks, np.where(doubted[:, None, None], np.nan, points), motion.fps, like, SIGMA_M)
    subject = Subject.average(body, landmarks, like)
    return replace(measured, subject=replace(subject, betas=constant(motion.betas, subject.betas)))
