"""Add glove recordings to a body's motion. The wrists synchronise the two recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.hand_skeleton import ANGLES, NUM_ANGLES, informed_joints
from solver_backend.body.hands import JOINTS_OF_A_HAND, by_joint, hand_skeletons, with_fingers
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.fitters.hands.solve_hands import FINGER_JOINTS as FINGERS
from solver_backend.fitters.hands.solve_hands import finger_turns_of, with_finger_turns
from solver_backend.geometry.arrays import true_runs
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.types import Motion
from solver_backend.types.motion import GloveTake
from solver_backend.types.shapes import Float

RATE = 100.0  # Samples per second of both speeds. Hands need half of this (Winter 2009: 99 % of motion is below 15 Hz).
_SMOOTHED_S, _APART_S = 0.06, 0.5  # Averaging time of speeds, and distance between clearly different offsets, seconds.
_OVERLAP_S, _OVERLAP = 2.0, 0.5  # Smallest overlap in seconds, and relative to the shorter recording.
STILL_RAD_S = 0.15  # RMS angular speed below which a wrist is too still to be synchronised.


@dataclass(frozen=True)
class WristClock:
    """Time offset between two recordings of the same wrists, and how reliable it is."""

    offset_s: float  # Start of the other recording, in seconds of the first one.
    agreement: float  # Correlation of the speeds at this offset.
    next_best: float  # Highest correlation at a clearly different offset.
    certainty: float  # In standard deviations: ``atanh(r) sqrt(n' - 3)`` for n' independent samples (Fisher 1915).

    @property
    def is_sure(self) -> bool:
        """True if the offset is reliable."""
        clear = self.agreement > self.next_best + _CLEARLY
        return clear and self.agreement >= _AGREE and self.certainty >= _CERTAIN


def wrist_speeds(rotations: Float[np.ndarray, "n 3 3"], times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """Return the angular speeds of a wrist in rad/s at ``RATE`` samples per second, NaN if unknown.

    ``rotations`` are (F, 3, 3) in any world and axes, and ``times`` (F,) are ascending, in seconds.
    """
    steps = np.linalg.norm(log_so3(np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:]), axis=-1) / np.diff(times)
    middles = 0.5 * (times[1:] + times[:-1])
    even = np.arange(times[0], times[-1], 1.0 / RATE)
    known = np.isfinite(steps)
    if known.sum() < 2:
        return np.full(len(even), np.nan)
    width = max(1, round(_SMOOTHED_S * RATE))
    speeds = np.interp(even, middles[known], steps[known])
    return np.convolve(speeds, np.full(width, 1.0 / width), mode="same")


def find_wrist_clock(one: list[np.ndarray], other: list[np.ndarray]) -> WristClock | None:
    """Estimate when ``other`` starts on the clock of ``one``. Return None if it cannot be estimated.

    The offset maximises the correlation of all wrists' speeds over the overlap. A parabola refines it between samples.
    ``one`` and ``other`` are the angular speeds (n,) and (m,) of the same wrists at ``RATE`` samples per second. The
    result is None if the wrists are too still, or a recording is too short.
    """
    pairs = [(a, b) for a, b in zip(one, other, strict=True) if _moves(a) and _moves(b)]
    if not pairs:
        return None
    n, m = len(pairs[0][0]), len(pairs[0][1])
    least = max(round(_OVERLAP_S * RATE), round(_OVERLAP * min(n, m)))
    if min(n, m) < least:
        return None
    scores = np.mean([_correlations(a, b, least) for a, b in pairs], axis=0)
    offsets = np.arange(least - m, n - least + 1)
    best = int(scores.argmax())
    apart = np.abs(offsets - offsets[best]) > _APART_S * RATE
    agreement, at = float(scores[best]), int(offsets[best])
    samples = sum(_independent(a[max(at, 0) : at + m], b[max(-at, 0) : n - at]) for a, b in pairs)
    certainty = np.arctanh(min(agreement, 1.0 - 1e-9)) * np.sqrt(max(samples - 3.0, 0.0))
    offset = (at + _vertex(scores, best)) / RATE
    return WristClock(offset, agreement, float(scores[apart].max(initial=0.0)), float(certainty))


def _independent(a: np.ndarray, b: np.ndarray) -> float:
    """Return how many samples of two correlated series are independent: ``n / Σ_k ρ_a(k) ρ_b(k)``."""
    n = len(a)
    size = 1 << int(np.ceil(np.log2(2 * n)))
    power = [np.abs(np.fft.rfft(x - x.mean(), size)) ** 2 for x in (a, b)]
    own, other = (np.fft.irfft(p, size) for p in power)
    return n / max(float((own * other).sum() / (own[0] * other[0])), 1.0)


def _moves(speeds: np.ndarray) -> bool:
    return bool(len(speeds)) and bool(np.isfinite(speeds).all()) and float(np.sqrt((speeds**2).mean())) > STILL_RAD_S


def _correlations(a: np.ndarray, b: np.ndarray, least: int) -> np.ndarray:
    """Return the correlation of a and b over their overlap, for every offset of b relative to a.

    Sums over the overlap come from cumulative sums, and products from a convolution by the Fourier transform.
    """
    n, m = len(a), len(b)
    size = 1 << int(np.ceil(np.log2(n + m)))
    products = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    offsets = np.arange(least - m, n - least + 1)
    first, last = np.maximum(offsets, 0), np.minimum(offsets + m, n)
    count = last - first

    def total(values: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
        sums = np.concatenate([[0.0], np.cumsum(values)])
        return sums[stop] - sums[start]

    mean_a, mean_b = total(a, first, last) / count, total(b, first - offsets, last - offsets) / count
    var_a = total(a * a, first, last) / count - mean_a**2
    var_b = total(b * b, first - offsets, last - offsets) / count - mean_b**2
    together = products[offsets % size] / count - mean_a * mean_b
    return together / np.sqrt(np.maximum(var_a, 1e-12) * np.maximum(var_b, 1e-12))


def _vertex(scores: np.ndarray, best: int) -> float:
    """Return the offset, in samples, of the vertex of the parabola around the highest score."""
    if not 0 < best < len(scores) - 1:
        return 0.0
    before, here, after = scores[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    return 0.0 if bend >= 0 else float(0.5 * (before - after) / bend)


_AGREE, _CLEARLY, _CERTAIN = 0.6, 0.1, 5.0
"""Thresholds for a reliable offset: correlation of speeds, lead over other offsets, and significance in standard
deviations."""
_BEYOND_DEG, _BEYOND_SHARE = 15.0, 0.05  # Degrees beyond human ranges and share of frames that are reported.


@dataclass(frozen=True)
class MergedHands:
    """A motion with hands from gloves, and diagnostics."""

    motion: Motion
    offset_s: float  # Start of the gloves' recording in seconds of the motion.
    found: tuple[Diagnostic, ...]


def merge_gloves(motion: Motion, body: Body, gloves: GloveTake, offset_s: float | None = None) -> MergedHands:
    """Add the fingers in a glove recording to a motion. The body and its wrists do not change.

    Args:
        motion: the body's motion. Fingers on a side without a glove do not change.
        offset_s: start of the gloves' recording in seconds of the motion. None estimates it from the wrists' rotations.

    Raises:
        BodyInvalid: the body has no fingers.
        MotionInvalid: the motion is for another body, or the recordings have no frame in common.
    """
    if motion.body != body.id:
        raise MotionInvalid(f"The motion was solved with the body {motion.body}, not {body.id}.", where="motion")
    found: list[Diagnostic] = []
    if offset_s is None:
        offset_s, clock = _offset(motion, gloves)
        found += clock
    times = np.arange(motion.num_frames) / motion.fps - offset_s
    covered = (times > gloves.times[0] - 1e-6) & (times < gloves.times[-1] + 1e-6)
    if not covered.any():
        message = f"The gloves' {gloves.times[-1]:.1f} s, starting at {offset_s:+.1f} s, do not overlap the motion."
        raise MotionInvalid(message, where=gloves.name, hint="Use a different --offset.")
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
    turns, shape = finger_turns_of(motion), (motion.num_frames, 2, JOINTS_OF_A_HAND)
    if turns is None:
        return np.zeros((*shape, 3)), np.ones(shape, bool), False
    resting = np.zeros(shape, bool) if motion.resting is None else motion.resting[:, FINGERS].reshape(shape).copy()
    return turns.reshape(*shape, 3).copy(), resting, True


def _offset(motion: Motion, gloves: GloveTake) -> tuple[float, list[Diagnostic]]:
    """Estimate the start of the gloves' recording in seconds (0 if unknown), with diagnostics."""
    theirs = [wrist_speeds(gloves.palms[:, side], gloves.times) for side in range(2)]
    own = [wrist_speeds(turns, np.arange(motion.num_frames) / motion.fps) for turns in _wrists(motion)]
    clock = find_wrist_clock(own, theirs)
    if clock is None:
        return 0.0, [diagnostic("gloves_time", result="unknown", severity=Severity.WARNING)]
    other = find_wrist_clock(own, theirs[::-1])
    if other is not None and other.is_sure and other.agreement > clock.agreement + _CLEARLY:
        return 0.0, [diagnostic("gloves_sides_exchanged", agreement=100.0 * other.agreement)]
    figures: dict[str, Any] = {"offset": clock.offset_s, "agreement": 100.0 * clock.agreement}
    if clock.is_sure:
        return clock.offset_s, [diagnostic("gloves_time", result="found", **figures)]
    return 0.0, [diagnostic("gloves_time", result="unsure", severity=Severity.WARNING, **figures)]


def _wrists(motion: Motion) -> list[np.ndarray]:
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
    angles = np.full((len(times), NUM_ANGLES), np.nan)
    for a in range(NUM_ANGLES):
        known = np.isfinite(gloves.angles[:, side, a])
        if known.sum() > 1:
            within = covered & (times >= gloves.times[known][0] - 1e-6) & (times <= gloves.times[known][-1] + 1e-6)
            angles[within, a] = np.interp(times[within], gloves.times[known], gloves.angles[known, side, a])
    return angles


def _beyond(angles: np.ndarray, side: int) -> list[Diagnostic]:
    prior = load_hand_prior()
    off = np.nan_to_num(np.maximum(angles - prior.high, prior.low - angles))
    often = np.flatnonzero((off > np.deg2rad(_BEYOND_DEG)).mean(axis=0) > _BEYOND_SHARE)
    if not len(often):
        return []
    names = [f"{ANGLES[a].replace('_', ' ')} by {np.degrees(off[:, a].max()):.0f}°" for a in often]
    return [diagnostic("gloves_beyond_ranges", side=SIDES[side], angles=names)]
