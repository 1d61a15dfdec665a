"""Hands of gloves on a body's motion: brought to its time by the wrists, unknown angles by the prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_angles import ANGLES, NUM_ANGLES, informed_joints
from solver_backend.body.hand_on_body import JOINTS_OF_A_HAND, by_joint, hand_skeletons
from solver_backend.body.hands import with_fingers
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.hand_points import SIDES
from solver_backend.fitters.motion_import.wrist_clock import WristClock, find_wrist_clock, wrist_speeds
from solver_backend.fitters.output.finger_turns import FINGERS, finger_turns_of, with_finger_turns
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.runs import true_runs
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Motion
from solver_backend.types.motion import GloveTake

_AGREE, _CLEARLY, _CERTAIN = 0.6, 0.1, 5.0
"""Correlation of the wrists' speeds from which a time is sure, by how much every other is lower, and its certainty: of
some hundred offsets that are tried, chance reaches 5 standard deviations once in ten thousand takes."""
_BEYOND_DEG, _BEYOND_SHARE = 15.0, 0.05
"""Degrees beyond people's ranges, and share of the frames, from which angles are doubtful."""


@dataclass(frozen=True)
class MergedHands:
    """A motion with the hands of gloves."""

    motion: Motion
    offset_s: float
    """Second of the motion at which the gloves begin."""
    found: tuple[Diagnostic, ...]
    """What was found on the way."""


def merge_gloves(motion: Motion, body: Body, gloves: GloveTake, offset_s: float | None = None) -> MergedHands:
    """Return the motion with the fingers of a glove recording; the body and its wrists stay as they are.

    Args:
        motion: of the body; fingers of sides that the gloves lack stay.
        body: of the motion.
        gloves: the recording.
        offset_s: second of the motion at which it begins; None finds it by the wrists' turns.

    Raises:
        BodyInvalid: the body has no fingers.
        MotionInvalid: the motion is of another body, or the recordings share no frame.
    """
    if motion.body != body.id:
        raise MotionInvalid(f"The motion is of the body {motion.body}, not {body.id}.", where="motion")
    found: list[Diagnostic] = []
    if offset_s is None:
        offset_s, clock = _offset(motion, gloves)
        found += clock
    times = np.arange(motion.num_frames) / motion.fps - offset_s
    covered = (times > gloves.times[0] - 1e-6) & (times < gloves.times[-1] + 1e-6)
    if not covered.any():
        raise MotionInvalid(
            f"The gloves' {gloves.times[-1]:.1f} s from {offset_s:+.1f} s share no frame with the motion.",
            where=gloves.name, hint="Give another --offset.",
        )  # fmt: skip
    if not covered.all():
        found.append(diagnostic("gloves_cover_part", frames=true_runs(~covered), share=100.0 * covered.mean()))
    turns, resting, had = _fingers(motion)
    prior, unknown = load_hand_prior(), set[str]()
    for side, skeleton in enumerate(hand_skeletons(with_fingers(body))):
        if side not in gloves.sides and had:
            continue
        angles = _at(gloves, side, times, covered)
        known = np.isfinite(angles)
        if side in gloves.sides:
            unknown |= {ANGLES[a] for a in np.flatnonzero(~known[covered].any(axis=0))}
            found += _beyond(angles, side)
        turns[:, side] = log_so3(by_joint(skeleton.local_rotations(prior.completed(angles))))
        resting[:, side] = by_joint(~informed_joints(known))
    if unknown:
        names = [name for name in ANGLES if name in unknown]
        found.append(diagnostic("gloves_angles_unknown", angles=[name.replace("_", " ") for name in names]))
    flat = (motion.num_frames, 2 * JOINTS_OF_A_HAND)
    merged = with_finger_turns(motion, body, turns.reshape(*flat, 3), resting.reshape(flat))
    return MergedHands(merged, float(offset_s), tuple(found))


def _fingers(motion: Motion) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return (F, 2, 15, 3) turns of the fingers and (F, 2, 15) which rest, to be written to; and whether it has any."""
    turns, shape = finger_turns_of(motion), (motion.num_frames, 2, JOINTS_OF_A_HAND)
    if turns is None:
        return np.zeros((*shape, 3)), np.ones(shape, bool), False
    resting = np.zeros(shape, bool) if motion.resting is None else motion.resting[:, FINGERS].reshape(shape).copy()
    return turns.reshape(*shape, 3).copy(), resting, True


def _offset(motion: Motion, gloves: GloveTake) -> tuple[float, list[Diagnostic]]:
    """Return the second at which the gloves begin, 0 where nothing shows it, and what was found."""
    theirs = [wrist_speeds(gloves.palms[:, side], gloves.times) for side in range(2)]
    own = [wrist_speeds(turns, np.arange(motion.num_frames) / motion.fps) for turns in _wrists(motion)]
    clock = find_wrist_clock(own, theirs)
    if clock is None:
        return 0.0, [diagnostic("gloves_time_unknown")]
    other = find_wrist_clock(own, theirs[::-1])
    if other is not None and _is_sure(other) and other.agreement > clock.agreement + _CLEARLY:
        return 0.0, [diagnostic("gloves_sides_exchanged", agreement=100.0 * other.agreement)]
    if not _is_sure(clock):
        return 0.0, [diagnostic("gloves_time_unsure", offset=clock.offset_s, agreement=100.0 * clock.agreement)]
    return clock.offset_s, [
        diagnostic("gloves_time_found", offset=clock.offset_s, agreement=100.0 * clock.agreement)
    ]  # fmt: skip


def _is_sure(clock: WristClock) -> bool:
    clear = clock.agreement > clock.next_best + _CLEARLY
    return clear and clock.agreement >= _AGREE and clock.certainty >= _CERTAIN


def _wrists(motion: Motion) -> list[np.ndarray]:
    """Return (F, 3, 3) world rotations of the left and the right wrist."""
    layout = motion.body_layout
    turns = np.concatenate([motion.global_orient, motion.body_pose], axis=1)
    local = exp_so3(turns.reshape(motion.num_frames, -1, 3))
    found = []
    for side in SIDES:
        joint = layout.joints.index(f"{side}_wrist")
        G = np.broadcast_to(np.eye(3), (motion.num_frames, 3, 3))
        while joint >= 0:
            G, joint = local[:, joint] @ G, layout.parents[joint]
        found.append(G)
    return found


def _at(gloves: GloveTake, side: int, times: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return (F, A) angles of a side at times of the gloves, NaN where they are unknown."""
    angles = np.full((len(times), NUM_ANGLES), np.nan)
    for a in range(NUM_ANGLES):
        known = np.isfinite(gloves.angles[:, side, a])
        if known.sum() > 1:
            within = covered & (times >= gloves.times[known][0] - 1e-6) & (times <= gloves.times[known][-1] + 1e-6)
            angles[within, a] = np.interp(times[within], gloves.times[known], gloves.angles[known, side, a])
    return angles


def _beyond(angles: np.ndarray, side: int) -> list[Diagnostic]:
    """Return a warning of angles that people do not have."""
    prior = load_hand_prior()
    off = np.nan_to_num(np.maximum(angles - prior.high, prior.low - angles))
    often = np.flatnonzero((off > np.deg2rad(_BEYOND_DEG)).mean(axis=0) > _BEYOND_SHARE)
    if not len(often):
        return []
    names = [f"{ANGLES[a].replace('_', ' ')} by {np.degrees(off[:, a].max()):.0f}°" for a in often]
    return [diagnostic("gloves_beyond_ranges", side=SIDES[side], angles=names)]
