"""An earlier motion of the take, of one camera, as where several cameras start and what holds where one alone sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.fitters.measurements.base import Measurements, RoughMotion
from solver_backend.fitters.model.frame_states import FrameStates
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.geometry.alignment import umeyama
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.symmetric import unpacked
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.residuals.relative_positions import RelativePositionTerm
from solver_backend.types import Motion

ALIKE_S = 0.07
"""Frames of so long count once, as where one camera is solved: its errors last."""
UNKNOWN_SIGMA_M = 0.1
"""Deviation per axis of a motion that does not state its own."""
SAME_DEG, SAME_M = 15.0, 0.6
"""A motion that lies no further off is in the same world: one camera is off so far in depth and in up, and a turn
that is fitted to its errors would turn right poses."""
LEAST_POINTS = 12
"""Points of both by which the motion finds its place in the world of the cameras."""


def begin_at(
    measurements: Measurements, motion: Motion, body: Body, prior: AutoencodingPrior, like: Array
) -> Measurements:  # fmt: skip
    """Return what several cameras measure, starting at a motion; its poses hold where too few points are located.

    The motion's world may be another: it is turned, scaled and shifted onto the located points of all frames.

    Args:
        measurements: of the views.
        motion: of the same frames and body.
        body: whose landmarks were located.
        prior: whose codes the start is in.
        like: array that sets kind, type and device.

    Raises:
        MotionInvalid: the motion is of other frames or another body.
    """
    motion.require_body(body.id, body.layout.recorded, where="start")
    if motion.num_frames != measurements.num_frames:
        raise MotionInvalid(
            f"The motion to start at has {motion.num_frames} frames, the capture {measurements.num_frames}.",
            where="start", hint="Solve one camera of this capture, over the same frames.",
        )  # fmt: skip
    poses = PosedFrames.of_motion(motion, np.zeros(1))
    landmarks = measurements.landmarks
    points = np.asarray(pose_landmarks(body, landmarks, motion.betas, poses.root, poses.local, poses.transl).points)
    scale, R, t = _placed(points, measurements)
    known = np.flatnonzero(np.isfinite(motion.transl).all(axis=1))
    pelvis = np.asarray(body.rest_joints(motion.betas))[0]
    places = scale * (poses.transl + pelvis) @ R.T + t - pelvis
    local = np.asarray(poses.local)[:, : len(prior.joints)]
    states = FrameStates(constant(prior.encode(local), like), constant(R @ poses.root, like), constant(places, like))
    joint = [motion.body_layout.joints.index(body.layout.joints[j]) for j in np.argmax(landmarks.weights, axis=1)]
    covariance = _covariances(motion, R)[:, joint]
    precision = np.linalg.inv(covariance) * ~measurements.seen[:, None, None, None]
    share = 1.0 / max(1.0, ALIKE_S * measurements.fps)
    held = RelativePositionTerm.of(points @ R.T, precision, share, like)
    rough = RoughMotion(known, states.select(known))
    return replace(measurements, rough=rough, relative=(*measurements.relative, held))


def _placed(points: np.ndarray, measurements: Measurements) -> tuple[float, np.ndarray, np.ndarray]:
    """Return scale, rotation and shift that bring a motion's points onto those that were located."""
    both = measurements.located & np.isfinite(points).all(-1)
    if both.sum() < LEAST_POINTS:
        return 1.0, np.eye(3), np.zeros(3)
    scale, R, t = (np.asarray(part) for part in umeyama(points[both], measurements.points[both], with_scale=True))
    turn = np.degrees(np.arccos(np.clip(0.5 * (np.trace(R) - 1.0), -1.0, 1.0)))
    apart = np.median(np.linalg.norm(points[both] - measurements.points[both], axis=-1))
    return (1.0, np.eye(3), np.zeros(3)) if turn < SAME_DEG and apart < SAME_M else (float(scale), R, t)


def _covariances(motion: Motion, R: np.ndarray) -> np.ndarray:
    """Return (F, J, 3, 3) covariances of the joints in the turned world, m²."""
    if motion.joint_covariance is None:
        shape = (*motion.joints.shape[:2], 3, 3)
        return np.broadcast_to(UNKNOWN_SIGMA_M**2 * np.eye(3), shape)
    return R @ unpacked(motion.joint_covariance.astype(np.float64)) @ R.T
