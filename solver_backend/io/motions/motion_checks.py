"""What a motion's numbers can be: one table of checks for motions of any reader and for the results of a solve.

What is impossible is refused; what is merely odd is a warning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
"""Beyond the range of a joint and its margin, and the share of the frames that makes it worth a warning: one joint in
0.1 % of CMU's frames lies beyond, and one of 73 clips, whose skeleton was converted wrongly, has so many of them."""
LARGEST_BETA = 4.0
"""Standard deviations of people, in which SMPL scales a shape coefficient: 1 person in 16,000 has more."""
FASTEST_M_S = 20.0
"""Of the pelvis; the fastest runners reach 12.5 m/s."""

AnyMotion = Motion | AmassClip | BvhClip


class _Numbers(NamedTuple):
    """What a motion of any kind has."""

    fps: float
    places: np.ndarray
    """(F, 3) metres."""
    body_pose: np.ndarray | None
    """(F, 69) axis-angle of SMPL's joints; None where the body has others, whose ranges are not known."""
    betas: np.ndarray


def checked_motion(motion: AnyMotion, where: str) -> None:
    """Make sure that a motion can be.

    Raises:
        MotionInvalid: its rate or its places cannot be.
    """
    numbers = _numbers(motion)
    for find in _IMPOSSIBLE:
        for found in find(numbers):
            words = word(found)
            raise MotionInvalid(words.what, where=where, hint=words.advice)


def check_motion(motion: AnyMotion) -> tuple[Diagnostic, ...]:
    """Return everything that is odd about a motion."""
    numbers = _numbers(motion)
    return tuple(found for find in _ODD for found in find(numbers))


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


def _odd_shape(motion: _Numbers) -> Iterator[Diagnostic]:
    yield from odd_shape(motion.betas)


def odd_shape(betas: np.ndarray) -> Iterator[Diagnostic]:
    """Yield that a shape is no person's."""
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


_Check = Callable[[_Numbers], Iterator[Diagnostic]]
_IMPOSSIBLE: tuple[_Check, ...] = (_impossible_rate, _impossibly_far)
_ODD: tuple[_Check, ...] = (_odd_rate, _too_fast, _odd_shape, _outside_anatomy)
