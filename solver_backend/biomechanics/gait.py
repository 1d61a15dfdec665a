"""Find foot strikes, toe-offs and strides, and average curves over gait cycles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver_backend.biomechanics.joint_angles import Angles
from solver_backend.biomechanics.segments import PosedSegments
from solver_backend.types import FLAG_UNSEEN, MarkerCloud
from solver_backend.types.shapes import Float

SIDES = ("left", "right")
# Chosen on the TUNED takes in tests/biomechanics/agreement.py (four laboratories, 60 and 100 Hz) against the 20 N
# threshold of their force plates, and evaluated on the other takes.
SWING_M = 0.25  # Shortest distance that a foot travels forward during a swing, in metres.
REACH_M = 0.15  # Smallest change of a foot's position in front of the pelvis between the two ends of a step, in metres.
LANDING_M_S = 0.1  # Vertical speed below which a falling heel has landed, in m/s.
LOW_M = 0.05  # Largest height in metres of a heel gliding over the floor, above its lowest position.
LANDING_S = 0.25  # Longest time in seconds from the foremost heel position to the landing.
PAUSE = 1.5  # Shortest stride that must contain a pause, relative to the take's median stride. Chosen by hand.
CYCLE_POINTS = 101  # Points of a mean curve, one per percent of the cycle.


MEASURES = {
    "time_s": "stride time", "length_m": "stride length", "speed_m_s": "speed", "cadence_per_min": "cadence",
    "stance_percent": "stance",
}  # fmt: skip
"""Name of each value that describes a stride."""
UNITS = {
    "stride time": "s", "stride length": "m", "speed": "m/s", "cadence": "steps/min", "stance": "%",
}  # fmt: skip
"""Unit of each value, by name."""


@dataclass(frozen=True)
class Stride:
    """A gait cycle of one foot, from a foot strike to the next strike of the same foot."""

    side: str
    strike_s: float
    off_s: float
    next_s: float
    length_m: float  # Horizontal distance between the heel's two contacts, NaN on a treadmill.

    @property
    def time_s(self) -> float:
        """Stride time in seconds."""
        return self.next_s - self.strike_s

    @property
    def stance_percent(self) -> float:
        """Percentage of the stride during which the foot is on the floor."""
        return 100.0 * (self.off_s - self.strike_s) / self.time_s

    @property
    def cadence_per_min(self) -> float:
        """Cadence: steps of both feet per minute at the pace of this stride."""
        return 120.0 / self.time_s

    @property
    def speed_m_s(self) -> float:
        """Mean walking speed in metres per second, NaN on a treadmill."""
        return self.length_m / self.time_s


@dataclass(frozen=True)
class Gait:
    """Foot strikes, toe-offs and strides in a take, with times in seconds from the first frame of the take."""

    strikes: dict[str, np.ndarray]  # By side.
    offs: dict[str, np.ndarray]  # By side.
    strides: tuple[Stride, ...]

    def events(self) -> list[tuple[float, str, str]]:
        """Return the time, side and C3D name of every gait event, in chronological order."""
        named = (("Foot Strike", self.strikes), ("Foot Off", self.offs))
        found = [(float(t), side.title(), name) for name, times in named for side in SIDES for t in times[side]]
        return sorted(found)


def find_gait(posed: PosedSegments, cloud: MarkerCloud, flags: np.ndarray | None = None) -> Gait:
    """Find foot strikes, toe-offs and strides from heels and toes (``open_sim.virtual_markers``).

    A foot leaves the floor when its toes are farthest behind the pelvis (Zeni et al. 2008). It strikes when the heel
    stops falling after its foremost position, or at that position if it glides over the floor. Steps without a forward
    swing, as in a squat, and strides with a pause are excluded. Events and strides with interpolated frames are also
    excluded (``FLAG_UNSEEN`` in the motion's (F,) flags).
    """
    labels, fps = list(cloud.labels or ()), cloud.fps
    forward = posed.rotations["pelvis"][:, :, 0] * (1.0, 0.0, 1.0)
    forward = forward / np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
    pelvis = posed.joints["pelvis"] @ posed.ground.T
    strikes, offs, strides = {}, {}, []
    for side in SIDES:
        letter = side[0].upper()
        heel, first, fifth = (
            in_ground(cloud.positions[:, labels.index(letter + name)]) for name in ("CAL", "TOE", "MT5")
        )
        toes = 0.5 * (first + fifth)
        found = _events_of_foot(heel, toes, pelvis, forward, fps)
        strikes[side], offs[side] = (times[_is_seen(times * fps, flags)] for times in found)
        strides += _strides(side, *found, heel, pelvis, fps)
    if strides:
        longest = PAUSE * float(np.median([stride.time_s for stride in strides]))
        strides = [stride for stride in strides if stride.time_s <= longest and _is_seen_whole(stride, fps, flags)]
    return Gait(strikes, offs, tuple(sorted(strides, key=lambda stride: stride.strike_s)))


def _is_seen(frames: np.ndarray, flags: np.ndarray | None) -> np.ndarray:
    if flags is None:
        return np.ones(len(frames), dtype=bool)
    return flags[np.clip(np.round(frames).astype(int), 0, len(flags) - 1)] & FLAG_UNSEEN == 0


def _is_seen_whole(stride: Stride, fps: float, flags: np.ndarray | None) -> bool:
    first, last = round(stride.strike_s * fps), round(stride.next_s * fps)
    return bool(_is_seen(np.arange(first, last + 1), flags).all())


def in_ground(points: np.ndarray) -> np.ndarray:
    """Convert (F, 3) points from Z up to Y up."""
    return points[:, [0, 2, 1]] * (1.0, 1.0, -1.0)


def _events_of_foot(
    heel: np.ndarray, toes: np.ndarray, pelvis: np.ndarray, forward: np.ndarray, fps: float
) -> tuple[np.ndarray, np.ndarray]:
    strikes, offs, last = [], [], len(heel) - 1
    if last < 2:
        return np.zeros(0), np.zeros(0)
    front, behind = (((points - pelvis) * forward).sum(axis=1) for points in (heel, toes))
    fall = np.gradient(heel[:, 1], 1.0 / fps)
    turns = _turns(front, REACH_M)
    begins_in_swing = len(turns) > 1 and front[turns[1]] < front[0]
    if begins_in_swing and fall[0] < -LANDING_M_S:
        strikes += _landings(fall, 0, fps)
    for before, start, end in zip([0, *turns], turns, turns[1:], strict=False):
        if front[end] < front[start] or (heel[end] - heel[start]) @ forward[end] < SWING_M:
            continue  # The foot moves backwards, or moves forward only with the pelvis.
        left = before + int(behind[before : end + 1].argmin())
        if 0 < left < last:
            offs.append(left + _vertex(-behind, left))
        glides = fall[end : end + int(LANDING_S * fps) + 1].min() >= -LANDING_M_S
        if not glides:
            strikes += _landings(fall, end, fps)
        elif end < last and heel[end, 1] < heel[before:end, 1].min() + LOW_M:
            strikes.append(end + _vertex(front, end))
    return np.array(strikes) / fps, np.array(offs) / fps


def _landings(fall: np.ndarray, first: int, fps: float) -> list[float]:
    """Return a list with the fractional frame at which the heel stops falling after ``first``, empty if it does not."""
    part = fall[first : first + int(LANDING_S * fps) + 1]
    landed = np.flatnonzero((part[:-1] < -LANDING_M_S) & (part[1:] >= -LANDING_M_S))
    return [first + int(k) + float((-LANDING_M_S - part[k]) / (part[k + 1] - part[k])) for k in landed[:1]]


def _turns(curve: np.ndarray, reach: float) -> list[int]:
    """Return frame 0 and the turning points of a curve (F,). Between them, the curve changes by at least ``reach``."""
    slope = np.diff(curve)
    extremes = np.flatnonzero(slope[1:] * slope[:-1] <= 0.0) + 1
    found, at, rises = [0], 0, None
    for k in [*extremes.tolist(), len(curve) - 1]:
        if rises is None:
            if abs(curve[k] - curve[0]) >= reach:
                at, rises = k, bool(curve[k] > curve[0])
        elif (curve[k] > curve[at]) == rises:
            at = k
        elif abs(curve[k] - curve[at]) >= reach:
            found.append(at)
            at, rises = k, not rises
    return found if at == 0 else [*found, at]


def _vertex(curve: np.ndarray, at: int) -> float:
    """Refine a maximum at frame ``at`` by a parabola through three frames. Return the offset from ``at``."""
    before, here, after = curve[at - 1 : at + 2]
    return float(0.5 * (before - after) / min(before - 2.0 * here + after, -1e-12))


def _strides(
    side: str, strikes: np.ndarray, offs: np.ndarray, heel: np.ndarray, pelvis: np.ndarray, fps: float
) -> list[Stride]:
    """Return the strides between a foot's strikes that contain exactly one toe-off. Lengths are NaN on a treadmill."""
    found, frames = [], np.arange(len(heel)) / fps

    def way(points: np.ndarray, start: float, end: float) -> float:
        steps = [np.interp(end, frames, points[:, k]) - np.interp(start, frames, points[:, k]) for k in (0, 2)]
        return float(np.hypot(*steps))

    for first, last in pairwise(strikes):
        between = offs[(offs > first) & (offs < last)]
        if len(between) == 1:
            on_treadmill = way(pelvis, first, last) < 0.5 * way(heel, between[0], last)
            length = np.nan if on_treadmill else way(heel, first, last)
            found.append(Stride(side, float(first), float(between[0]), float(last), length))
    return found


def mean_cycles(angles: Angles, gait: Gait, fps: float) -> dict[str, Float[np.ndarray, "points 2"]]:
    """Return the mean and standard deviation (101, 2) of each angle in degrees, from 0 to 100 % of the gait cycle.

    Angles of the left side are averaged over the left foot's strides, and all other angles over the right foot's
    strides. An angle is omitted if its foot has no strides.
    """
    share, times, found = np.linspace(0.0, 1.0, CYCLE_POINTS), np.arange(len(angles.degrees)) / fps, {}
    for k, name in enumerate(angles.names):
        side = name.split("_")[0] if name.startswith(SIDES) else "right"
        cycles = [s for s in gait.strides if s.side == side]
        if cycles:
            curves = np.array([np.interp(s.strike_s + share * s.time_s, times, angles.degrees[:, k]) for s in cycles])
            apart = curves.mean(axis=1, keepdims=True) - curves[:1].mean()
            curves = curves - 360.0 * np.round(apart / 360.0)  # Each circle of an arm adds 360 degrees.
            spread = np.std(curves, axis=0, ddof=1) if len(curves) > 1 else np.full(CYCLE_POINTS, np.nan)
            found[name] = np.stack([np.mean(curves, axis=0), spread], axis=-1)
    return found
