"""Find and close the best cycle in a motion, and join motions at the standing foot.

Each side of a seam moves by half the difference in pose and velocity, which fades away from the seam: ``x(u) ± (δ + u
δ') h(|u| / T) / 2`` with ``h(x) = 1 - 3x² + 2x³``, u seconds from the seam and blend time T. Pose and velocity are
therefore continuous ("inertialization", Bollo 2018, but on both sides). Clips are aligned by their planted feet. There,
the differences of pelvis and leg cancel out, so that feet do not slide. Around a join, legs bend to keep feet in place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from .body_layout import SMPL
from .clips import (
    body_path,
    edits_of,
    note_edit,
    pose_tree,
    repose,
    require_joints,
    resample,
    rest_joints,
    take_frames,
    turn_covariance,
    unobserved,
)
from .errors import MotionInvalid
from .limb_bend import bend_to, eased, longest_reach, within_reach
from .limb_bend import fade as smoothstep
from .motion_file import FRAMES_AXIS, MotionFile
from .so3 import (
    matrix_from_rotvec,
    quat_from_rotvec,
    quat_multiply,
    rotvec_from_matrix,
    rotvec_from_quat,
)

SEAM_DEGREES, SEAM_MM = 2.0, 5.0
"""Largest joint rotation and joint distance at the seam of a loop."""
GAP_DEGREES, GAP_MM = 15.0, 80.0
"""Largest differences in rotation (degrees) and position (mm) that a loop can hide. Two strides differ by half as much,
and other movements by more.
"""
BLEND_S = 0.25  # Seconds on each side of a seam during which the difference fades, chosen by hand.
SHORTEST_S = 0.4  # Shortest cycle in seconds, less than two running steps.
_LEAST_MOTION = 0.5  # Smallest mean joint speed of a cycle relative to the take, to avoid looping a pause.
_VELOCITY_S = 0.1  # Seconds that convert velocity differences to distances, chosen by hand.
_CONTACT_M = 0.05  # Distance in metres charged for a foot that stands in only one of two frames, chosen by hand.
_SAMPLES = 900  # Largest number of frames compared with each other. Longer takes are subsampled for the first search.
_FINE_HZ = 50.0
"""Smallest frame rate at which running cycles close: 11 of 12 runs by CMU subject 09 at 60 Hz, and none at 30 Hz."""
_CANDIDATES, _REFINED, _CLOSED = 60, 3, 12
"""Numbers of nearest pairs that are compared joint by joint, of best pairs that are refined in a subsampled take, and
of best cycles that are closed and measured."""
_FALSE_IF_NONE = ("resting", "flags", "keyframes")  # Per-frame arrays for which None means all zeros.
_ONLY_IN_BOTH = (
    ("contacts", "foot contacts"),
    ("joint_sigma", "standard deviations"),
    ("joint_covariance", "standard deviations"),
)
_SAME_LEGS = 0.002  # Relative difference in leg length (2 mm per metre) up to which a join does not report scaling.
_LEGS = ((1, 4, 7), (2, 5, 8))  # SMPL's hip, knee and ankle joints of each leg.
_FEET = ((7, 10), (8, 11))  # SMPL's ankle and ball joints of each foot.
_MOVED_M = 1e-9  # Smallest offset of a foot in metres for which its leg bends.
_FACING = (SMPL.both("hip"), SMPL.both("shoulder"))


@dataclass(frozen=True)
class Placement:
    """A rigid motion on the ground: a rotation about Z, then a translation."""

    angle: float  # Rotation angle in radians.
    shift: np.ndarray  # (3,) horizontal translation in metres.

    @property
    def turn(self) -> np.ndarray:
        """(3, 3) matrix of the rotation about Z."""
        return matrix_from_rotvec(np.array([0.0, 0.0, self.angle]))

    def move(self, motion: MotionFile) -> MotionFile:
        """Apply the rigid motion to the body, root path and covariances of a motion."""
        R = self.turn
        rotvec = motion.rotvec.copy()
        rotvec[:, 0] = rotvec_from_matrix(R @ matrix_from_rotvec(rotvec[:, 0]))
        done = repose(motion, rotvec, (motion.transl + rest_joints(motion)[0]) @ R.T + self.shift)
        covariance, root = motion.joint_covariance, motion.root
        root = None if root is None else self.path(root)
        covariance = None if covariance is None else turn_covariance(covariance, R)
        return replace(done, joint_covariance=covariance, turn_covariance=None, root=root)

    def path(self, root: np.ndarray) -> np.ndarray:
        """Apply the rigid motion to a root path (F, 3) of x, y and heading."""
        return np.column_stack([root[:, :2] @ self.turn[:2, :2].T + self.shift[:2], root[:, 2] + self.angle])


@dataclass(frozen=True)
class Seam:
    """Difference in pose and velocity between a frame of one motion and a frame of another motion."""

    placement: Placement  # Rigid motion from the second motion's ground to the first motion's.
    turns: np.ndarray  # (J, 3) rotation vectors in radians, relative to each joint.
    turn_rates: np.ndarray  # (J, 3) rotation rates in radians per second.
    shift: np.ndarray  # (3,) pelvis translation in metres.
    velocity: np.ndarray  # (3,) pelvis velocity in metres per second.
    degrees: float  # Largest joint rotation.
    mm: float  # Largest joint distance.
    corner_degrees: float  # Largest rotation change of a joint in one frame due to the difference in rates.
    corner_mm: float  # Largest position change of a joint in one frame.

    def __str__(self) -> str:
        return f"joints are {self.degrees:.1f} degrees and {self.mm:.0f} mm apart"

    @property
    def without_rates(self) -> Seam:
        """The seam without its velocity difference, which is extrapolated and inaccurate at a motion's ends."""
        rates: dict[str, Any] = {"turn_rates": 0.0 * self.turn_rates, "velocity": 0.0 * self.velocity}
        return replace(self, corner_degrees=0.0, corner_mm=0.0, **rates)


def measure_seam(before: MotionFile, at: int, after: MotionFile, start: int) -> Seam:
    """Measure the difference between frame ``at`` of one motion and frame ``start`` of the next motion."""
    placement = _aligned(before, at, after, start)
    R = placement.turn
    one, two = _state(before, at), _state(after, start)
    turned = two.quat.copy()
    turned[0] = quat_multiply(_heading(placement.angle), turned[0])
    turns = rotvec_from_quat(quat_multiply(_conjugate(turned), one.quat))
    places = two.joints @ R.T + placement.shift
    return Seam(
        placement,
        turns,
        one.rates - two.rates,
        one.joints[0] - places[0],
        (one.velocities - two.velocities @ R.T)[0],
        _largest(np.degrees(turns)),
        _largest(1000.0 * (one.joints - places)),
        _largest(np.degrees(one.rates - two.rates)) / before.fps,
        _largest(1000.0 * (one.velocities - two.velocities @ R.T)) / before.fps,
    )


def _largest(vectors: np.ndarray) -> float:
    return float(np.linalg.norm(vectors, axis=-1).max())


@dataclass(frozen=True)
class _State:
    quat: np.ndarray  # (J, 4) rotations.
    rates: np.ndarray  # (J, 3) rates in radians per second, relative to each joint.
    joints: np.ndarray  # (K, 3) positions of SMPL's joints, metres.
    velocities: np.ndarray  # (K, 3) metres per second.


def _state(motion: MotionFile, at: int) -> _State:
    """Return the pose and velocity in a frame. At the ends of a motion, the velocity is extrapolated."""
    last = motion.num_frames - 1
    steps, weights = (at - 1, at), (0.5, 0.5)
    if at in (0, last):
        steps, weights = ((0, 1) if at == 0 else (at - 1, at - 2)), (1.5, -0.5)
    steps = np.clip(steps, 0, max(last - 1, 0))
    ends = np.minimum(steps + 1, last)
    weights = motion.fps * np.array(weights)
    quat, low, high = (quat_from_rotvec(motion.rotvec[frames]) for frames in (at, steps, ends))
    turns = rotvec_from_quat(quat_multiply(_conjugate(low), high))
    ways = _joints(motion)[ends] - _joints(motion)[steps]
    turns, ways = (np.tensordot(weights, values, axes=1) for values in (turns, ways))
    return _State(quat, turns, _joints(motion)[at], ways)


def _conjugate(quat: np.ndarray) -> np.ndarray:
    return quat * [1.0, -1.0, -1.0, -1.0]


def _heading(angle: float) -> np.ndarray:
    return np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])


def _aligned(before: MotionFile, at: int, after: MotionFile, start: int) -> Placement:
    """Return the rigid motion on the ground that best aligns two poses (Kovar et al. 2002, eq. 2).

    The translation aligns the feet that are planted in both poses, or all joints if no feet are planted.
    """
    a, b = _joints(before)[at], _joints(after)[start]
    p, q = (a - a.mean(axis=0))[:, :2], (b - b.mean(axis=0))[:, :2]
    angle = float(np.arctan2((q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]).sum(), (p * q).sum()))
    stand = [] if before.contacts is None or after.contacts is None else before.contacts[at] & after.contacts[start]
    feet = [joint for foot, stands in zip(_FEET, stand, strict=False) if stands for joint in foot]
    chosen = feet or list(range(len(a)))
    placement = Placement(angle, np.zeros(3))
    shift = a[chosen].mean(axis=0) - placement.turn @ b[chosen].mean(axis=0)
    return Placement(angle, shift * [1.0, 1.0, 0.0])


def blend_end(motion: MotionFile, seam: Seam, blend_s: float) -> MotionFile:
    """Correct the end of the first motion by half of a seam's difference. The correction fades in."""
    return _offset(motion, seam, (np.arange(motion.num_frames) - (motion.num_frames - 1)) / motion.fps, -0.5, blend_s)


def blend_start(motion: MotionFile, seam: Seam, blend_s: float) -> MotionFile:
    """Correct the start of the second motion by half of a seam's difference. The correction fades out."""
    back = seam.placement.turn.T
    own = replace(seam, shift=back @ seam.shift, velocity=back @ seam.velocity)
    return _offset(motion, own, np.arange(motion.num_frames) / motion.fps, 0.5, blend_s)


def _offset(motion: MotionFile, seam: Seam, u: np.ndarray, share: float, blend_s: float) -> MotionFile:
    fade = share * smoothstep(np.abs(u), max(blend_s, 1e-6), 0.0)
    turns = fade[:, None, None] * (seam.turns + u[:, None, None] * seam.turn_rates)
    rotvec = rotvec_from_quat(quat_multiply(quat_from_rotvec(motion.rotvec), quat_from_rotvec(turns)))
    rotvec = np.where((fade == 0.0)[:, None, None], motion.rotvec, rotvec)
    shift = fade[:, None] * (seam.shift + u[:, None] * seam.velocity)
    return repose(unobserved(motion), rotvec, motion.transl + rest_joints(motion)[0] + shift)


# Loops


@dataclass(frozen=True)
class Loop:
    """A closed cycle of a motion."""

    motion: MotionFile  # Frames of the cycle. The last frame is followed by the first.
    first: int  # First frame in the take, counted from 0.
    last: int  # Frame in the take that is replaced by the first one.
    gap: Seam  # Original difference between these two frames.
    seam_degrees: float  # Largest rotation between a joint in the first frame and its continuation from the last frame.
    seam_mm: float  # Largest distance between these joints.

    @property
    def is_near(self) -> bool:
        """True if the difference is small enough for blending to hide it."""
        return self.gap.degrees <= GAP_DEGREES and self.gap.mm <= GAP_MM

    @property
    def is_good(self) -> bool:
        """True if blending hides the difference, and the remaining jump at the seam is too small to see."""
        return self.is_near and self.seam_degrees <= SEAM_DEGREES and self.seam_mm <= SEAM_MM


def find_loop(
    motion: MotionFile, shortest_s: float = SHORTEST_S, blend_s: float = BLEND_S, *, stay: bool = False
) -> Loop:
    """Find the best closed cycle in a motion (see ``find_cycles`` and ``close_cycle``).

    Raises:
        MotionInvalid: the motion is too short, or its best cycle cannot be closed.
    """
    found = find_cycles(motion, shortest_s)
    if not found:
        what = f"The motion has {motion.num_frames} frames and no cycle of {shortest_s:g} s with movement."
        raise MotionInvalid(what, where=motion.name, hint="Choose a shorter cycle or a longer motion.")
    best = None
    for pair in found[:_CLOSED]:
        loop = close_cycle(motion, *pair, blend_s, stay=stay)
        if loop.is_good:
            return loop
        best = best or loop
    assert best is not None, "there is a cycle"
    what = f"The motion does not repeat. In its best cycle, frames {best.first} to {best.last}, {best.gap}"
    what += f", with a seam of {best.seam_degrees:.1f} degrees and {best.seam_mm:.1f} mm."
    hint = "Record two strides or repetitions, or trim the motion to two of them."
    if motion.fps < _FINE_HZ and best.is_near:
        hint = "Resample the motion to 60 Hz first, because a fast joint moves far in each frame."
    raise MotionInvalid(what, where=motion.name, hint=hint)


def find_cycles(motion: MotionFile, shortest_s: float = SHORTEST_S) -> list[tuple[int, int]]:
    """Find cycles in a motion, best first. Return the first and last frame of each, which show similar poses.

    Frame pairs are compared by the positions and velocities of the joints relative to the body's position and direction
    (Kovar et al. 2002, "Motion Graphs"), and by foot contacts. The nearest pairs are compared joint by joint.
    """
    frames, least = motion.num_frames, max(shortest_s * motion.fps, 4)
    if frames <= least:
        return []
    step = -(-frames // _SAMPLES)
    at = np.arange(0, frames, step)
    near = _distances(motion, at)
    apart = at[None] - at[:, None]
    near[apart < least] = np.inf
    if motion.contacts is not None:
        stands = motion.contacts[at]
        near += _CONTACT_M**2 * (stands[:, None] != stands[None]).sum(axis=-1)
    moved = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(_joints(motion), axis=0), axis=-1).mean(axis=1))])
    slow = _LEAST_MOTION * moved[-1] / frames
    near[moved[at][None] - moved[at][:, None] < slow * apart] = np.inf

    def is_cycle(first: int, last: int) -> bool:
        inside = first >= 0 and last < frames and last - first >= least
        return inside and bool(moved[last] - moved[first] >= slow * (last - first))

    def rank(pair: tuple[int, int]) -> tuple[float, int]:
        feet = 0 if motion.contacts is None else (motion.contacts[pair[0]] != motion.contacts[pair[1]]).sum()
        return round(_size(_gap(motion, *pair)) + feet, 2), pair[1] - pair[0]

    best = sorted(((int(a), int(b)) for a, b in at[_lowest(near)]), key=rank)
    around = range(1 - step, step)
    finer = [(a + i, b + j) for a, b in best[:_REFINED] for i in around for j in around] if step > 1 else best
    return sorted((pair for pair in finer if is_cycle(*pair)), key=rank)


def _gap(motion: MotionFile, first: int, last: int) -> Seam:
    """Return the seam between two frames of a motion. It has no velocities if a frame is at an end of the motion."""
    seam = measure_seam(motion, last, motion, first)
    return seam if first > 0 and last < motion.num_frames - 1 else seam.without_rates


def _size(seam: Seam) -> float:
    """Return the largest ratio between a seam's differences and their limits."""
    apart = seam.degrees / GAP_DEGREES, seam.mm / GAP_MM
    return max(*apart, seam.corner_degrees / 2.0 / SEAM_DEGREES, seam.corner_mm / 2.0 / SEAM_MM)


def _joints(motion: MotionFile) -> np.ndarray:
    return require_joints(motion)[:, : SMPL.num_joints]


def _distances(motion: MotionFile, at: np.ndarray) -> np.ndarray:
    """Return the (N, N) mean square distances in m² between the poses and velocities in N frames."""
    joints = _joints(motion)
    across = np.sum([joints[:, left] - joints[:, right] for left, right in _FACING], axis=0)
    back = matrix_from_rotvec(-np.arctan2(across[:, 1], across[:, 0])[:, None] * [0.0, 0.0, 1.0])
    velocity = np.gradient(joints, axis=0) * motion.fps
    points = np.concatenate([joints - joints[:, :1] * [1.0, 1.0, 0.0], _VELOCITY_S * velocity], axis=1)
    features = (points @ np.swapaxes(back, -1, -2))[at].reshape(len(at), -1)
    square = (features**2).sum(axis=1)
    return np.maximum(square[:, None] + square[None] - 2.0 * features @ features.T, 0.0) / joints.shape[1]


def _lowest(near: np.ndarray) -> np.ndarray:
    """Return the (K, 2) indices of the lowest local minima in a distance matrix, lowest first."""
    padded = np.pad(near, 1, constant_values=np.inf)
    rows, columns = near.shape
    around = [padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    found = np.argwhere(np.isfinite(near) & np.all([near <= other for other in around], axis=0))
    return found[np.argsort(near[tuple(found.T)], kind="stable")[:_CANDIDATES]]


def close_cycle(motion: MotionFile, first: int, last: int, blend_s: float = BLEND_S, *, stay: bool = False) -> Loop:
    """Close a range of frames into a cycle. The last frame is removed, because the first frame follows in its place.

    Args:
        blend_s: seconds on each side during which the difference fades, at most half the cycle.
        stay: remove the cycle's travel and rotation at a constant rate.
    """
    gap = _gap(motion, first, last)
    blend_s = min(blend_s, (last - first) / motion.fps / 2.0)
    cycle = blend_start(blend_end(take_frames(motion, np.arange(first, last + 1)), gap, blend_s), gap, blend_s)
    degrees, mm = _jump(cycle, motion, last)
    cycle = take_frames(_with_closed_root(cycle, gap.placement), np.arange(last - first))
    if stay:
        cycle = _stay(cycle, gap.placement)
    edit = {"frames": [first, last], "gap_degrees": round(gap.degrees, 2), "gap_mm": round(gap.mm, 1)}
    return Loop(note_edit(cycle, "loop", **edit), first, last, gap, degrees, mm)


def _jump(closed: MotionFile, motion: MotionFile, last: int) -> tuple[float, float]:
    """Return the largest rotation (degrees) and distance (mm) that remain at the seam of a cycle."""
    one, two = quat_from_rotvec(closed.rotvec[-2:]), quat_from_rotvec(motion.rotvec[last - 1 : last + 1])
    turns = quat_multiply(
        _conjugate(quat_multiply(_conjugate(two[0]), two[1])), quat_multiply(_conjugate(one[0]), one[1])
    )
    way = np.diff(_joints(closed)[-2:], axis=0) - np.diff(_joints(motion)[last - 1 : last + 1], axis=0)
    angle = np.linalg.norm(rotvec_from_quat(turns), axis=-1).max()
    return float(np.degrees(angle)), float(1000.0 * np.linalg.norm(way, axis=-1).max())


def _with_closed_root(cycle: MotionFile, placement: Placement) -> MotionFile:
    """Close a cycle's root path by distributing the difference between its ends over the cycle."""
    if cycle.root is None:
        return cycle
    gap = placement.path(cycle.root[:1])[0] - cycle.root[-1]
    gap[2] = np.remainder(gap[2] + np.pi, 2.0 * np.pi) - np.pi
    return replace(cycle, root=cycle.root + np.linspace(0.0, 1.0, cycle.num_frames)[:, None] * gap)


def _stay(cycle: MotionFile, placement: Placement) -> MotionFile:
    """Remove a cycle's travel and rotation: move frame i of N back by i / N of the cycle's rigid motion."""
    share = np.arange(cycle.num_frames) / cycle.num_frames
    way = share[:, None] * (_arc(share * placement.angle) @ np.linalg.solve(_arc(placement.angle), placement.shift))
    back = matrix_from_rotvec(-(share * placement.angle)[:, None] * [0.0, 0.0, 1.0])
    pelvis = cycle.transl + rest_joints(cycle)[0] - way
    rotvec = cycle.rotvec.copy()
    rotvec[:, 0] = rotvec_from_matrix(back @ matrix_from_rotvec(rotvec[:, 0]))
    props = tuple(
        replace(
            prop,
            rotvec=rotvec_from_matrix(back @ matrix_from_rotvec(prop.rotvec)),
            transl=(back @ (prop.transl - way)[..., None])[..., 0],
        )
        for prop in cycle.props
    )
    covariance = cycle.joint_covariance
    covariance = None if covariance is None else turn_covariance(covariance, back[:, None])
    done = repose(cycle, rotvec, (back @ pelvis[..., None])[..., 0])
    return replace(done, joint_covariance=covariance, root=None, props=props)


def _arc(angle: float | np.ndarray) -> np.ndarray:
    """Return the (..., 3, 3) mean of all rotations about Z from 0 to ``angle`` (left Jacobian of SE(2))."""
    half = np.asarray(angle) / 2.0
    return np.sinc(half / np.pi)[..., None, None] * matrix_from_rotvec(half[..., None] * [0.0, 0.0, 1.0])


# Joins


def join(first: MotionFile, second: MotionFile, blend_s: float = BLEND_S) -> tuple[MotionFile, Seam]:
    """Join two motions of the same body. Return the joined motion and the seam.

    The second motion is resampled to the first one's frame rate. It is moved and rotated on the ground to continue the
    first motion, so that feet that are planted in both motions stay in place. Its first frame replaces the first
    motion's last frame. If the body shapes differ, the second motion gets the first one's shape, and its pelvis
    positions are scaled by leg length. ``join_notes`` lists what is lost.

    Raises:
        MotionInvalid: the motions have different bodies or joints.
    """
    first.body_layout.require_same_joints(second.body_layout, second.name)
    if first.body and second.body and first.body != second.body:
        what = f"The motions have different bodies, {first.body} and {second.body}."
        raise MotionInvalid(what, where=second.name, hint="Join motions of one body.")
    if second.fps != first.fps:
        second = resample(second, first.fps)
    second = _in_shape_of(second, first)
    seam = measure_seam(first, first.num_frames - 1, second, 0)
    before = blend_end(first, seam, min(blend_s, (first.num_frames - 1) / first.fps))
    after = seam.placement.move(blend_start(second, seam, min(blend_s, (second.num_frames - 1) / first.fps)))
    before = take_frames(before, np.arange(first.num_frames - 1)) if first.num_frames > 1 else before
    both = {name: (getattr(before, name), getattr(after, name)) for name in FRAMES_AXIS}
    arrays: dict[str, Any] = {
        name: None if one is None or two is None else np.concatenate([one, two], axis=FRAMES_AXIS[name])
        for name, (one, two) in both.items()
    }
    for name in _FALSE_IF_NONE:
        one, two = both[name]
        if (known := two if one is None else one) is not None and arrays[name] is None:
            blank = (np.zeros((motion.num_frames, *known.shape[1:]), known.dtype) for motion in (before, after))
            arrays[name] = np.concatenate([x if y is None else y for x, y in zip(blank, (one, two), strict=True)])
    pelvis = np.concatenate([motion.transl + rest_joints(motion)[0] for motion in (before, after)])
    joined = replace(before, props=(), **arrays)
    joined = repose(joined, joined.rotvec, pelvis)
    apart = np.concatenate([_joints(first)[:-1], _joints(seam.placement.move(second))])
    joined = _hold_feet(joined, apart, first.num_frames - 1, blend_s)
    if first.root is not None or second.root is not None:
        joined = replace(joined, root=body_path(joined))
    edit = {"with": second.name, "at": first.num_frames - 1}
    edit |= {"gap_degrees": round(seam.degrees, 2), "gap_mm": round(seam.mm, 1)}
    return note_edit(joined, "join", **edit), seam


def _hold_feet(joined: MotionFile, apart: np.ndarray, at: int, blend_s: float) -> MotionFile:
    """Keep the planted feet of a join where they were before the blend.

    A foot that stands on both sides of the seam keeps its position in the first motion. Its offset from the blended
    motion fades within ``blend_s`` around each contact. The leg bends to reach the ankle, and the pelvis follows a leg
    that is too short. Feet keep their directions.

    Args:
        apart: (F, 24, 3) joints of both motions before the blend.
        at: first frame of the second motion.
    """
    if joined.contacts is None or not 0 < at < joined.num_frames:
        return joined
    rest, parents = rest_joints(joined), joined.body_layout.parents
    G, p = pose_tree(rest, parents, joined.rotvec, joined.transl)
    shifts = []
    for (_, ball), stands in zip(_FEET, joined.contacts.T, strict=True):
        places, stood, fade = apart[:, ball].copy(), np.flatnonzero(stands), blend_s * joined.fps
        gap = stood[stood >= at].min(initial=len(p)) - stood[stood < at].max(initial=-len(p))
        if gap == 1:
            end = at + int(np.append(~stands[at:], True).argmax())
            away, frames = places[at - 1] - places[at], np.arange(len(p) - at)
            places[at:end, :2] += away[:2]
            # The stands on both sides may differ in height.
            places[at:, 2] += away[2] * smoothstep(frames, max(end - at, fade), 0.0)
        shifts.append(eased(places - p[:, ball], stood, fade if gap == 1 else min(fade, 0.5 * gap - 1.0)))
    bones = [(p[:, knee] - p[:, hip], p[:, ankle] - p[:, knee]) for hip, knee, ankle in _LEGS]
    ways = np.stack([p[:, leg[2]] - p[:, leg[0]] + shift for leg, shift in zip(_LEGS, shifts, strict=True)])
    way = within_reach(0.0 * ways, ways, np.stack([longest_reach(*bone) for bone in bones]))
    turned, moved = G.copy(), (np.abs(shifts).max(axis=(0, 2)) > _MOVED_M)[:, None]
    for (hip, knee, _), goal, (upper, lower) in zip(_LEGS, ways, bones, strict=True):
        turn_upper, turn_lower = bend_to(goal - way, upper, lower, G[:, knee, :, 0])
        turned[:, hip], turned[:, knee] = turn_upper @ G[:, hip], turn_lower @ G[:, knee]
    rotvec = joined.rotvec.copy()
    for joint in (joint for leg in _LEGS for joint in leg):
        local = rotvec_from_matrix(np.swapaxes(turned[:, parents[joint]], -1, -2) @ turned[:, joint])
        rotvec[:, joint] = np.where(moved, local, rotvec[:, joint])
    return repose(joined, rotvec, p[:, 0] + np.where(moved, way, 0.0))


def splice(motion: MotionFile, part: MotionFile, first: int, fades: tuple[int, int] = (0, 0)) -> MotionFile:
    """Replace a motion's poses with ``part``, starting at frame ``first``.

    Args:
        fades: numbers of frames over which the part fades in and out at its start and end.

    Raises:
        MotionInvalid: the part has other joints, or more frames than the motion has from ``first`` on.
    """
    last = first + part.num_frames - 1
    if part.body_layout.joints != motion.body_layout.joints or not 0 <= first <= last < motion.num_frames:
        what = f"A part of {part.num_frames} frames does not fit in the motion at frame {first}."
        hint = f"The motion has {motion.num_frames} frames. Both must have the same joints."
        raise MotionInvalid(what, where=motion.name, hint=hint)
    frames, place = slice(first, last + 1), np.arange(1, part.num_frames + 1)
    x = np.minimum(np.minimum(place / (fades[0] + 1), place[::-1] / (fades[1] + 1)), 1.0)
    share = x * x * (3.0 - 2.0 * x)
    old = matrix_from_rotvec(motion.rotvec[frames])
    turns = rotvec_from_matrix(np.swapaxes(old, -1, -2) @ matrix_from_rotvec(part.rotvec))
    rotvec, pelvis = motion.rotvec.copy(), motion.transl + rest_joints(motion)[0]
    rotvec[frames] = rotvec_from_matrix(old @ matrix_from_rotvec(share[:, None, None] * turns))
    moved = part.transl + rest_joints(part)[0] - pelvis[frames]
    pelvis[frames] += share[:, None] * moved
    edit = (edits_of(part) or [{"verb": "motion splice"}])[-1]
    values = {name: value for name, value in edit.items() if name not in ("verb", "frames")}
    done = repose(unobserved(motion), rotvec, pelvis)
    return note_edit(done, edit["verb"].removeprefix("motion "), frames=[first, last], **values)


def join_notes(first: MotionFile, second: MotionFile) -> list[str]:
    """Return a sentence about each change or omission that ``join`` makes to two motions."""
    ratio, notes = _legs(first) / _legs(second), list[str]()
    if abs(ratio - 1.0) > _SAME_LEGS:
        notes.append(f"The second motion was scaled to the legs of the first one, {ratio:.3f} times as long")
    kinds = {kind for name, kind in _ONLY_IN_BOTH if (getattr(first, name) is None) != (getattr(second, name) is None)}
    notes += [f"Only one of the motions has {kind}, so the result has none" for kind in sorted(kinds)]
    return [*notes, "The result has no props"] if first.props or second.props else notes


def _in_shape_of(motion: MotionFile, other: MotionFile) -> MotionFile:
    """Transfer a motion to another motion's bones. The pelvis positions are scaled, so that feet stay on the ground."""
    rest, ratio = rest_joints(other), _legs(other) / _legs(motion)
    if np.allclose(rest - rest[0], rest_joints(motion) - rest_joints(motion)[0], atol=1e-5):
        return motion
    transl = ratio * (motion.transl + rest_joints(motion)[0]) - rest[0]
    joints = pose_tree(rest, motion.body_layout.parents, motion.rotvec, transl)[1]
    return replace(unobserved(motion), transl=transl, joints=joints, betas=other.betas)


def _legs(motion: MotionFile) -> float:
    """Return the total length of both legs from hip to ankle in metres. Raise MotionInvalid if it is 0."""
    rest = rest_joints(motion)
    length = sum(float(np.linalg.norm(rest[a] - rest[b])) for leg in _LEGS for a, b in pairwise(leg))
    if length == 0.0:
        raise MotionInvalid("The legs of the body have no length.", where=motion.name, hint="Export the motion again.")
    return length
