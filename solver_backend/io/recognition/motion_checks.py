"""What a motion's numbers can be: one table of checks for motions of any reader and for the results of a solve.

What is impossible is an error; what is merely odd is a sentence that a person sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from solver_backend.body.joint_limits import posture_excess_deg
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, SMPL_JOINTS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.runs import true_runs
from solver_backend.io.motions.amass import AmassClip
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.io.recognition.camera_names import listing
from solver_backend.io.recognition.range_checks import FRAME_RATES, IMPOSSIBLE_M, POSSIBLE_FRAME_RATES
from solver_backend.types import Motion

OUTSIDE_DEG, OUTSIDE_SHARE = 45.0, 0.01
"""Beyond the range of a joint and its margin, and the share of the frames that makes it worth a sentence: one joint in
0.1 % of CMU's frames lies beyond, and one of 73 clips, whose skeleton was converted wrongly, has so many of them."""
LARGEST_BETA = 10.0
FASTEST_M_S = 20.0
"""Of the pelvis; the fastest runners reach 12.5 m/s."""

AnyMotion = Motion | AmassClip | BvhClip


class _Numbers(NamedTuple):
    """What a motion of any kind has."""

    fps: float
    places: np.ndarray
    """(F, 3) metres."""
    body_pose: np.ndarray | None
    """(F, 69) axis-angle of SMPL's joints."""
    betas: np.ndarray


def checked_motion(motion: AnyMotion, where: str) -> None:
    """Make sure that a motion can be.

    Raises:
        MotionInvalid: its rate or its places cannot be.
    """
    numbers = _numbers(motion)
    for find in _IMPOSSIBLE:
        for sentence in find(numbers):
            raise MotionInvalid(sentence, where=where, hint="Check the file's units and rate.")


def motion_problems(motion: AnyMotion) -> tuple[str, ...]:
    """Return a sentence for everything that is odd about a motion."""
    numbers = _numbers(motion)
    return tuple(sentence for find in _ODD for sentence in find(numbers))


def _numbers(motion: AnyMotion) -> _Numbers:
    if isinstance(motion, BvhClip):
        return _Numbers(motion.fps, motion.root_positions, None, np.zeros(0))
    return _Numbers(motion.fps, motion.transl, motion.body_pose, motion.betas)


def _impossible_rate(motion: _Numbers) -> Iterator[str]:
    least, most = POSSIBLE_FRAME_RATES
    if not least <= motion.fps <= most:
        yield f"The frame rate must be {least:g} to {most:g}, not {motion.fps:g}."


def _impossibly_far(motion: _Numbers) -> Iterator[str]:
    away = np.abs(motion.places).max(axis=-1, initial=0.0)
    if (away > IMPOSSIBLE_M).any():
        frame = int(away.argmax())
        yield f"In frame {frame} the body would be {away[frame] / 1000:.3g} km from the origin."


def _odd_rate(motion: _Numbers) -> Iterator[str]:
    if not FRAME_RATES[0] <= motion.fps <= FRAME_RATES[1]:
        yield f"{motion.fps:g} frames a second is not what is recorded; give the rate if it is another."


def _too_fast(motion: _Numbers) -> Iterator[str]:
    speed = np.linalg.norm(np.diff(motion.places, axis=0), axis=-1) * motion.fps
    if (speed > FASTEST_M_S).any():
        frame = int(speed.argmax())
        yield f"The body moves at up to {speed[frame]:.3g} m/s (frame {frame + 1}): are the rate and the unit right?"


def _odd_shape(motion: _Numbers) -> Iterator[str]:
    if motion.betas.size and (worst := float(np.abs(motion.betas).max())) > LARGEST_BETA:
        yield f"A shape coefficient is {worst:.3g}; those of people lie within {LARGEST_BETA:g}."


def _outside_anatomy(motion: _Numbers) -> Iterator[str]:
    if motion.body_pose is None or not len(motion.body_pose):
        return
    rotvec = np.asarray(motion.body_pose, np.float64).reshape(len(motion.body_pose), -1, 3)[:, :NUM_BODY_JOINTS]
    beyond = np.asarray(posture_excess_deg(exp_so3(rotvec)))
    outside = beyond > OUTSIDE_DEG
    joints = np.flatnonzero(outside.mean(axis=0) > OUTSIDE_SHARE)
    if not joints.size:
        return
    named = [f"{SMPL_JOINTS[1 + j]} (by up to {beyond[:, j].max():.0f}°)" for j in joints]
    first, last = true_runs(outside[:, joints].any(axis=1))[0]
    yield (
        f"Joints are turned far beyond what people's can in {int(outside[:, joints].any(axis=1).sum())} frames, first "
        f"in {first}-{last}: {listing(named)}. Are left and right, the axes and the joints' order right?"
    )


_IMPOSSIBLE: tuple[Callable[[_Numbers], Iterator[str]], ...] = (_impossible_rate, _impossibly_far)
_ODD: tuple[Callable[[_Numbers], Iterator[str]], ...] = (_odd_rate, _too_fast, _odd_shape, _outside_anatomy)
