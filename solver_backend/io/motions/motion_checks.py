"""Check the values of motions. Impossible values are errors, implausible ones are warnings."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_backend.body.joint_limits import posture_excess_deg
from solver_backend.exchange import plausible
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic, word
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_JOINTS
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.motions.amass import AmassClip
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.types import Motion

OUTSIDE_DEG, OUTSIDE_SHARE = 45.0, 0.01
"""Angle in degrees beyond a joint's range and its margin, and the fraction of such frames that causes a warning. In CMU
motions, 0.1 % of the frames are such frames. One clip in 73, with a badly converted skeleton, reaches this fraction."""
LARGEST_BETA = 6.0
"""Largest SMPL shape coefficient in standard deviations. Solves of 50 good captures reach 5.7, the largest with small
children (``bench good_captures``)."""
FASTEST_M_S = 20.0  # Largest pelvis speed in m/s. The fastest runners reach 12.5 m/s.

AnyMotion = Motion | AmassClip | BvhClip


def checked_motion(motion: AnyMotion, where: str) -> None:
    """Raise MotionInvalid if the frame rate or a position of a motion is impossible."""
    found = [*_odd_rate(motion, plausible.FRAME_RATES, Severity.ERROR)]
    away = np.abs(_places(motion)).max(axis=-1, initial=0.0)
    if (away > plausible.FARTHEST_M).any():
        frame = int(away.argmax())
        found.append(diagnostic("motion_place_impossible", frames=[(frame, frame)], size=away[frame] / 1000))
    if found:
        words = word(found[0])
        raise MotionInvalid(words.what, where=where, hint=words.advice)


def check_motion(motion: AnyMotion) -> tuple[Diagnostic, ...]:
    """Return warnings about implausible values in a motion."""
    found = [*_odd_rate(motion, plausible.USUAL_FRAME_RATES, Severity.WARNING)]
    speed = np.linalg.norm(np.diff(_places(motion), axis=0), axis=-1) * motion.fps
    if runs := true_runs(speed > FASTEST_M_S):
        found.append(diagnostic("motion_too_fast", frames=[(a, b + 1) for a, b in runs], size=speed.max(), done="kept"))
    if not isinstance(motion, BvhClip):
        found += [*odd_shape(motion.betas), *_outside_anatomy(motion)]
    return tuple(found)


def _places(motion: AnyMotion) -> np.ndarray:
    return motion.root_positions if isinstance(motion, BvhClip) else motion.transl


def _odd_rate(motion: AnyMotion, limits: tuple[float, float], severity: Severity) -> Iterator[Diagnostic]:
    least, most = limits
    if not least <= motion.fps <= most:
        yield diagnostic("motion_rate_odd", severity=severity, rate=motion.fps, least=least, most=most)


def odd_shape(betas: np.ndarray) -> Iterator[Diagnostic]:
    """Yield a warning if a shape coefficient other than the first (stature) is implausible."""
    if betas.size > 1 and (worst := float(np.abs(betas[1:]).max())) > LARGEST_BETA:
        yield diagnostic("shape_odd", size=worst, limit=LARGEST_BETA)


def _outside_anatomy(motion: Motion | AmassClip) -> Iterator[Diagnostic]:
    solved = SMPL_JOINTS[: NUM_BODY_JOINTS + 1]
    if isinstance(motion, Motion) and motion.body_layout.joints[: len(solved)] != solved:
        return  # The ranges of other joints are unknown.
    rotvec = np.asarray(motion.body_pose, np.float64).reshape(len(motion.body_pose), -1, 3)[:, :NUM_BODY_JOINTS]
    beyond = np.asarray(posture_excess_deg(exp_so3(rotvec)))
    outside = beyond > OUTSIDE_DEG
    joints = np.flatnonzero(outside.mean(axis=0) > OUTSIDE_SHARE) if len(outside) else np.zeros(0, int)
    if joints.size:
        excess = [f"{SMPL_JOINTS[1 + j]} by up to {beyond[:, j].max():.0f}°" for j in joints]
        anywhere = outside[:, joints].any(axis=1)
        names, frames, count = [SMPL_JOINTS[1 + j] for j in joints], true_runs(anywhere), int(anywhere.sum())
        yield diagnostic("pose_outside_anatomy", frames=frames, joints=names, count=count, excess=excess)
