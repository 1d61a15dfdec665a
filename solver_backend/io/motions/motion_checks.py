"""Checks of the numbers of motions from any reader and from a solve: impossible ones are errors, odd ones warnings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from solver_backend.body.joint_limits import posture_excess_deg
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, word
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_JOINTS
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.amass import AmassClip
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.io.recognition.range_checks import FRAME_RATES, IMPOSSIBLE_M, POSSIBLE_FRAME_RATES
from solver_backend.types import Motion

OUTSIDE_DEG, OUTSIDE_SHARE = 45.0, 0.01
"""Degrees beyond the range of a joint and its margin, and the share of the frames that gives a warning. One joint in
0.1 % of CMU's frames is beyond, and one of 73 clips, with a wrongly converted skeleton, has this share."""
LARGEST_BETA = 4.0
"""Standard deviations of people, the scale of SMPL's shape coefficients. 1 person in 16,000 has more."""
FASTEST_M_S = 20.0  # Speed of the pelvis. The fastest runners reach 12.5 m/s.

AnyMotion = Motion | AmassClip | BvhClip


class _Numbers(NamedTuple):
    """Common numbers of all kinds of motions."""

    fps: float
    places: np.ndarray
    """(F, 3) metres."""
    body_pose: np.ndarray | None
    """(F, 69) axis-angle of SMPL's joints, None for a body with other joints, whose ranges are unknown."""
    betas: np.ndarray


def checked_motion(motion: AnyMotion, where: str) -> None:
    """Raise MotionInvalid if the rate or the places of a motion are impossible."""
    numbers = _numbers(motion)
    for found in (*_impossible_rate(numbers), *_impossibly_far(numbers)):
        words = word(found)
        raise MotionInvalid(words.what, where=where, hint=words.advice)


def check_motion(motion: AnyMotion) -> tuple[Diagnostic, ...]:
    """Return warnings of everything odd in a motion."""
    numbers = _numbers(motion)
    body = _outside_anatomy(numbers)
    return (*_odd_rate(numbers), *_too_fast(numbers), *odd_shape(numbers.betas), *body)


def _numbers(motion: AnyMotion) -> _Numbers:
    if isinstance(motion, BvhClip):
        return _Numbers(motion.fps, motion.root_positions, None, np.zeros(0))
    solved = SMPL_JOINTS[: NUM_BODY_JOINTS + 1]
    other = isinstance(motion, Motion) and motion.body_layout.joints[: len(solved)] != solved
    return _Numbers(motion.fps, motion.transl, None if other else motion.body_pose, motion.betas)


def _impossible_rate(motion: _Numbers) -> Iterator[Diagnostic]:
    least, most = POSSIBLE_FRAME_RATES
    if not least <= motion.fps <= most:
        yield diagnostic("motion_rate_odd", rate=motion.fps, least=least, most=most)


def _impossibly_far(motion: _Numbers) -> Iterator[Diagnostic]:
    away = np.abs(motion.places).max(axis=-1, initial=0.0)
    if (away > IMPOSSIBLE_M).any():
        frame = int(away.argmax())
        yield diagnostic("motion_place_impossible", frames=[(frame, frame)], size=away[frame] / 1000)


def _odd_rate(motion: _Numbers) -> Iterator[Diagnostic]:
    least, most = FRAME_RATES
    if not least <= motion.fps <= most:
        yield diagnostic("motion_rate_odd", severity=Severity.WARNING, rate=motion.fps, least=least, most=most)


def _too_fast(motion: _Numbers) -> Iterator[Diagnostic]:
    speed = np.linalg.norm(np.diff(motion.places, axis=0), axis=-1) * motion.fps
    runs = true_runs(speed > FASTEST_M_S)
    if runs:
        yield diagnostic("motion_too_fast", frames=[(a, b + 1) for a, b in runs], size=speed.max())


def odd_shape(betas: np.ndarray) -> Iterator[Diagnostic]:
    """Yield a warning if a shape is no person's."""
    if betas.size and (worst := float(np.abs(betas).max())) > LARGEST_BETA:
        yield diagnostic("shape_odd", size=worst, limit=LARGEST_BETA)


def _outside_anatomy(motion: _Numbers) -> Iterator[Diagnostic]:
    if motion.body_pose is None or not len(motion.body_pose):
        return
    rotvec = np.asarray(motion.body_pose, np.float64).reshape(len(motion.body_pose), -1, 3)[:, :NUM_BODY_JOINTS]
    beyond = np.asarray(posture_excess_deg(exp_so3(rotvec)))
    outside = beyond > OUTSIDE_DEG
    joints = np.flatnonzero(outside.mean(axis=0) > OUTSIDE_SHARE)
    if not joints.size:
        return
    excess = [f"{SMPL_JOINTS[1 + j]} by up to {beyond[:, j].max():.0f}°" for j in joints]
    anywhere = outside[:, joints].any(axis=1)
    names, frames, count = [SMPL_JOINTS[1 + j] for j in joints], true_runs(anywhere), int(anywhere.sum())
    yield diagnostic("pose_outside_anatomy", frames=frames, joints=names, count=count, excess=excess)
