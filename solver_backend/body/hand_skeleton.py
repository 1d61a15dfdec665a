"""Pose a hand skeleton with joint angles, and compute points on its segments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.exchange.joint_sets import FINGERS, HAND_POINTS, NUM_HAND_POINTS, SIDES
from solver_backend.geometry.rotations import cross
from solver_backend.types.shapes import Bool, Float, Int

FLEXION, SPREAD, TWIST = 0, 1, 2  # Into the palm, towards the thumb (thumb: off the palm), about the bone.
_KINDS = ("flexion", "spread", "twist")
_THUMB = (("cmc", 0, (FLEXION, SPREAD, TWIST)), ("mcp", 1, (FLEXION,)), ("ip", 2, (FLEXION,)))
_OTHERS = (("mcp", 0, (FLEXION, SPREAD)), ("pip", 1, (FLEXION,)), ("dip", 2, (FLEXION,)))
_TABLE = [
    (f"{finger}_{place}_{_KINDS[kind]}", n, joint, kind)
    for n, finger in enumerate(FINGERS)
    for place, joint, kinds in (_OTHERS if n else _THUMB)
    for kind in kinds
]
ANGLES: tuple[str, ...] = tuple(row[0] for row in _TABLE)  # Names of a hand's angles, thumb first.
NUM_ANGLES = len(ANGLES)  # Number of angles in a hand.
FINGER_OF, JOINT_OF, KIND_OF = (np.array([row[i] for row in _TABLE]) for i in (1, 2, 3))
"""(A,) finger (index in ``FINGERS``), joint (0 next to the palm) and kind of rotation of each angle."""
FLEXION_OF = np.array([[r[1:3] for r in _TABLE].index(row[1:3]) for row in _TABLE])
"""(A,) index of the flexion angle at the joint of each angle."""
THUMB_TILT = float(np.deg2rad(45.0))  # A thumb bends across the palm, so its nail partly faces sideways.
KNUCKLES = tuple(HAND_POINTS.index(f"{finger}_mcp") for finger in ("middle", *FINGERS[1:]))
"""Points that define each finger's x axis as seen from the wrist. The thumb uses the middle finger's point."""


def side_sign(side: int) -> float:
    """Return the sign σ that mirrors a hand's axes: 1 for a right hand, -1 for a left hand."""
    return 1.0 if SIDES[side] == "right" else -1.0


def palm_frames(points: Float[np.ndarray, "n 21 3"], side: int) -> Float[np.ndarray, "n 5 3 3"]:
    """Return the (n, 5, 3, 3) palm frames, in which the first bone of each finger points along x at zero angles.

    ``points`` (n, 21, 3) are ``HAND_POINTS``. Side 0 is left, and 1 is right.
    """
    wrist, index, pinky = (points[:, i] for i in (0, KNUCKLES[1], KNUCKLES[-1]))
    # Seen from its back, fingers up, a right hand has its index on the left, so the product points at the viewer.
    dorsal = side_sign(side) * np.cross(pinky - wrist, index - wrist)
    x = _unit(points[:, KNUCKLES] - wrist[:, None])
    y = np.broadcast_to(dorsal[:, None], x.shape)
    y = _unit(y - (y * x).sum(-1, keepdims=True) * x)
    thumbward = -side_sign(side) * np.cross(x[:, 0], y[:, 0])
    y[:, 0] = np.cos(THUMB_TILT) * thumbward + np.sin(THUMB_TILT) * y[:, 0]
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def joint_rotations(angles: Float[np.ndarray, "n a"], side: int) -> Float[np.ndarray, "n 5 3 3 3"]:
    """Convert (n, A) finger angles in radians to rotations (n, 5, 3, 3, 3) of five fingers with three joints each."""
    turns = np.zeros((len(angles), 5, 3, 3))
    turns[:, FINGER_OF, JOINT_OF, KIND_OF] = angles
    sign = side_sign(side)
    flexion, spread, twist = -turns[..., FLEXION], sign * turns[..., SPREAD], sign * turns[..., TWIST]
    return _about(flexion, 2) @ _about(spread, 1) @ _about(twist, 0)


def measure_angles(points: Float[np.ndarray, "n 21 3"], side: int) -> Float[np.ndarray, "n a"]:
    """Measure (n, A) finger angles in radians on (n, 21, 3) ``HAND_POINTS``.

    If the unit vector v is a bone's direction in the axes of the previous segment, ``flexion = atan2(-v_y, v_x)`` and
    ``spread = asin(-σ v_z)``, with σ from ``side_sign``. Angles are NaN where points are missing. Twist cannot be
    measured on points and is 0.
    """
    frames = palm_frames(points, side)
    bones = _unit(np.diff(points[:, 1:].reshape(len(points), 5, 4, 3), axis=2))
    turns = np.zeros((len(points), 5, 3, 3))
    for joint in range(3):
        v: np.ndarray = (np.swapaxes(frames, -1, -2) @ bones[:, :, joint, :, None])[..., 0]
        flexion = np.arctan2(-v[..., 1], v[..., 0])
        spread = np.arcsin(np.clip(-v[..., 2], -1.0, 1.0)) if joint == 0 else np.zeros_like(flexion)
        turns[:, :, joint, FLEXION], turns[:, :, joint, SPREAD] = flexion, side_sign(side) * spread
        frames = frames @ _about(-flexion, 2) @ _about(spread, 1)
    return turns[:, FINGER_OF, JOINT_OF, KIND_OF]


def informed_joints(known: Bool[np.ndarray, "n a"]) -> Bool[np.ndarray, "n 5 3"]:
    """Return an (n, 5, 3) mask of finger joints with at least one known angle."""
    informed = np.zeros((len(known), 5, 3), bool)
    for finger, joint, angle in zip(FINGER_OF, JOINT_OF, known.T, strict=True):
        informed[:, finger, joint] |= angle
    return informed


def rotation_angles(turns: Float[np.ndarray, "n 5 3 3 3"], side: int) -> Float[np.ndarray, "n a"]:
    """Convert (n, 5, 3, 3, 3) joint rotations to (n, A) angles, inverting ``joint_rotations``."""
    x, sign = turns[..., 0], side_sign(side)
    spread = np.arcsin(np.clip(-x[..., 2], -1.0, 1.0)) * sign
    twist = np.arctan2(turns[..., 2, 1], turns[..., 2, 2]) * sign
    found = np.stack([np.arctan2(-x[..., 1], x[..., 0]), spread, twist], axis=-1)
    return found[:, FINGER_OF, JOINT_OF, KIND_OF]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _about(angle: np.ndarray, axis: int) -> np.ndarray:
    turns = np.zeros((*angle.shape, 3, 3))
    before, after = (axis + 1) % 3, (axis + 2) % 3
    turns[..., axis, axis] = 1.0
    turns[..., before, before] = turns[..., after, after] = np.cos(angle)
    turns[..., after, before] = np.sin(angle)
    turns[..., before, after] = -turns[..., after, before]
    return turns


@dataclass(frozen=True)
class HandSites:
    """L points fixed to hand segments, such as markers and keypoints."""

    finger: Int[np.ndarray, " sites"]  # (L,) index in ``FINGERS``, unused for the palm.
    segment: Int[np.ndarray, " sites"]  # (L,) 0 for the palm, 1 to 3 for the bones of the finger.
    offset: Float[np.ndarray, "sites 3"]  # (L, 3) metres from its joint in the segment's axes, or from the wrist.


@dataclass(frozen=True)
class PosedHand:
    """A hand skeleton in F poses, in hand axes with the wrist as origin."""

    frames: Float[np.ndarray, "n 5 4 3 3"]  # (F, 5, 4, 3, 3) segment frames, starting with the palm's at zero angles.
    joints: Float[np.ndarray, "n 5 4 3"]  # (F, 5, 4, 3) metres: the joints of each finger, and its tip.
    axes: Float[np.ndarray, "n a 3"]  # (F, A, 3) rotation axis of each angle.


@dataclass(frozen=True)
class HandSkeleton:
    """Bones and rest pose of one hand, in hand axes with the wrist as origin."""

    side: int  # 0 left, 1 right.
    palm: Float[np.ndarray, "5 3 3"]  # (5, 3, 3) frames from ``palm_frames`` at the fingers' roots.
    roots: Float[np.ndarray, "5 3"]  # (5, 3) metres: first joint of each finger relative to the wrist.
    bones: Float[np.ndarray, "5 3 3"]  # (5, 3, 3) metres: from each joint to the next or the tip, in its frame.
    rest: Float[np.ndarray, "5 3 3 3"]  # (5, 3, 3, 3) segment frames at rest.

    @classmethod
    def of_points(cls, points: Float[np.ndarray, "21 3"], side: int) -> HandSkeleton:
        """Build the skeleton from (21, 3) ``HAND_POINTS`` of a hand at rest, in metres."""
        own = (points - points[0])[None]
        palm, angles = palm_frames(own, side), measure_angles(own, side)
        chain = own[0, 1:].reshape(5, 4, 3)
        rest = _segments(palm, joint_rotations(angles, side))[0, :, 1:]
        bones = (np.swapaxes(rest, -1, -2) @ np.diff(chain, axis=1)[..., None])[..., 0]
        return cls(side, palm[0], chain[:, 0], bones, rest)

    def scaled(self, scale: float) -> HandSkeleton:
        """Return the hand with all lengths multiplied by ``scale``."""
        return replace(self, roots=scale * self.roots, bones=scale * self.bones)

    @property
    def rest_angles(self) -> Float[np.ndarray, " a"]:
        """(A,) finger angles at rest in radians."""
        return measure_angles(self.points_at_rest[None], self.side)[0]

    @property
    def points_at_rest(self) -> Float[np.ndarray, "21 3"]:
        """(21, 3) ``HAND_POINTS`` at rest in metres, with the wrist at the origin."""
        steps = (self.rest @ self.bones[..., None])[..., 0]
        chain = np.cumsum(np.concatenate([self.roots[:, None], steps], axis=1), axis=1)
        return np.concatenate([np.zeros((1, 3)), chain.reshape(-1, 3)])

    def keypoints(self) -> HandSites:
        """Return the ``HAND_POINTS`` as points that are fixed to the segments."""
        finger = np.concatenate([[0], np.repeat(np.arange(5), 4)])
        segment = np.concatenate([[0], np.tile(np.arange(4), 5)])
        offset = np.zeros((NUM_HAND_POINTS, 3))
        offset[1:] = np.concatenate([self.roots[:, None], self.bones], axis=1).reshape(-1, 3)
        return HandSites(finger, segment, offset)

    def pose(self, angles: Float[np.ndarray, "n a"]) -> PosedHand:
        """Pose the hand with (F, A) finger angles in radians."""
        turns = joint_rotations(angles, self.side)
        frames = _segments(np.broadcast_to(self.palm, (len(angles), 5, 3, 3)), turns)
        steps = (frames[:, :, 1:] @ self.bones[..., None])[..., 0]
        first = np.broadcast_to(self.roots, (len(angles), 5, 3))[:, :, None]
        joints = np.cumsum(np.concatenate([first, steps], axis=2), axis=2)
        return PosedHand(frames, joints, self._axes(frames, angles))

    def _axes(self, frames: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return (F, A, 3) axes of the finger angles: flexion about -z, then spread (y), then twist (x)."""
        before, after = frames[:, FINGER_OF, JOINT_OF], frames[:, FINGER_OF, JOINT_OF + 1]
        sign, kind = side_sign(self.side), KIND_OF[:, None]
        flexion = angles[:, FLEXION_OF, None]
        between = np.sin(flexion) * before[..., 0] + np.cos(flexion) * before[..., 1]
        turned = np.where(kind == SPREAD, sign * between, sign * after[..., 0])
        return np.where(kind == FLEXION, -before[..., 2], turned)

    def sites(self, posed: PosedHand, sites: HandSites) -> Float[np.ndarray, "n sites 3"]:
        """Return the (F, L, 3) positions of the sites on the posed hand, in metres, in the hand's axes."""
        origins = posed.joints[:, sites.finger, np.maximum(sites.segment - 1, 0)]
        origins = np.where((sites.segment == 0)[:, None], 0.0, origins)
        return origins + (site_frames(posed, sites) @ sites.offset[..., None])[..., 0]

    def site_jacobian(
        self, posed: PosedHand, sites: HandSites, points: Float[np.ndarray, "n sites 3"], turn: np.ndarray
    ) -> Float[np.ndarray, "n sites 3 a"]:
        """Return the (F, L, 3, A) derivatives of points w.r.t. the finger angles: ``R (axis × (point - joint))``.

        ``points`` (F, L, 3) are in metres in hand axes. ``turn`` (F, 3, 3) is R, the rotation from hand to output axes.
        """
        site, angle = np.nonzero((sites.finger[:, None] == FINGER_OF) & (sites.segment[:, None] > JOINT_OF))
        turn_T = np.swapaxes(turn, 1, 2)
        axes, levers = posed.axes @ turn_T, points[:, site] - posed.joints[:, FINGER_OF[angle], JOINT_OF[angle]]
        moved = cross(axes[:, angle], levers @ turn_T)
        jacobian = np.zeros((*points.shape, NUM_ANGLES))
        jacobian[:, site, :, angle] = np.moveaxis(moved, 1, 0)
        return jacobian

    def local_rotations(self, angles: Float[np.ndarray, "n a"]) -> Float[np.ndarray, "n 5 3 3 3"]:
        """Convert (F, A) angles to (F, 5, 3, 3, 3) finger rotations from rest, in the parents' rest frames.

        ``G_j = A_j A_j⁰ᵀ`` rotates segment j from its rest frame A_j⁰ to its posed frame A_j. The local rotation is
        ``R_j = G_pᵀ G_j``, where p is the parent of j.
        """
        posed = self.pose(angles)
        G = posed.frames[:, :, 1:] @ np.swapaxes(self.rest, -1, -2)
        local = G.copy()
        local[:, :, 1:] = np.swapaxes(G[:, :, :-1], -1, -2) @ G[:, :, 1:]
        return local

    def angles_of(self, local: Float[np.ndarray, "n 5 3 3 3"]) -> Float[np.ndarray, "n a"]:
        """Convert (F, 5, 3, 3, 3) finger rotations to the nearest (F, A) angles in radians."""
        G = [local[:, :, 0]]
        for joint in (1, 2):
            G.append(G[-1] @ local[:, :, joint])
        frames = np.stack(G, axis=2) @ self.rest
        palm = np.broadcast_to(self.palm[:, None], (len(local), 5, 1, 3, 3))
        before = np.concatenate([palm, frames[:, :, :2]], axis=2)
        return rotation_angles(np.swapaxes(before, -1, -2) @ frames, self.side)


def site_frames(posed: PosedHand, sites: HandSites) -> Float[np.ndarray, "n sites 3 3"]:
    """Return the (F, L, 3, 3) axes of the points' segments, which are the points' derivatives w.r.t. their offsets."""
    frames = posed.frames[:, sites.finger, sites.segment]
    return np.where((sites.segment == 0)[:, None, None], np.eye(3), frames)


def _segments(palm: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return the (F, 5, 4, 3, 3) frames of palm and finger segments. Each joint rotates all following segments."""
    frames = [palm]
    for joint in range(turns.shape[2]):
        frames.append(frames[-1] @ turns[:, :, joint])
    return np.stack(frames, axis=2)


RADIUS_M = (0.009, 0.0085, 0.0085, 0.008, 0.007)
"""Half the width of each finger at its last joint in metres, thumb first, for a hand of ``PALM_M`` (Garrett 1971)."""
PALM_M = 0.09  # Distance from wrist to middle knuckle in a hand with these widths.
BONES = np.array([[4 * finger + k, 4 * finger + k + 1] for finger in range(5) for k in range(1, 4)])
"""(15, 2) ends of the three bones beyond each finger's knuckle, as indices into ``HAND_POINTS``."""
_ONE, _OTHER = (pair for pair in np.triu_indices(len(BONES)))
_APART = _ONE // 3 != _OTHER // 3  # True for bones of different fingers.
PAIRS = np.stack([_ONE[_APART], _OTHER[_APART]])  # (2, 90) pairs of bones from different fingers.


@dataclass(frozen=True)
class FingerGaps:
    """Overlaps and nearest points of P pairs of bones from different fingers in F frames."""

    depth: Float[np.ndarray, "frames pairs"]  # (F, P) metres by which two bones overlap, negative if they do not.
    along: Float[np.ndarray, "frames pairs 2"]  # (F, P, 2) nearest points, as fractions along each bone.
    apart: Float[np.ndarray, "frames pairs 3"]  # (F, P, 3) metres from the second bone's nearest point to the first's.


def finger_gaps(points: Float[np.ndarray, "frames 21 3"]) -> FingerGaps:
    """Measure how far capsules around finger bones overlap, ``r_a + r_b - d``, for (F, 21, 3) ``HAND_POINTS``.

    r_a and r_b are the radii of two capsules, scaled by the palm's length, and d is the distance between the two bones.
    """
    radius = np.repeat(RADIUS_M, 3)
    palm = np.linalg.norm(points[:, 9] - points[:, 0], axis=-1)[:, None]
    (a, b), (c, d) = (np.moveaxis(points[:, BONES[bones]], 2, 0) for bones in PAIRS)
    along, apart = nearest_points(a, b, c, d)
    reach = (radius[PAIRS[0]] + radius[PAIRS[1]]) * palm / PALM_M
    return FingerGaps(reach - np.linalg.norm(apart, axis=-1), along, apart)


def finger_overlap(points: Float[np.ndarray, "frames 21 3"]) -> Float[np.ndarray, " frames"]:
    """Return the largest overlap (F,) of any two fingers in metres, or 0 in frames without an overlap."""
    return np.maximum(finger_gaps(points).depth.max(axis=1), 0.0)


def nearest_points(
    a: Float[np.ndarray, "*batch 3"],
    b: Float[np.ndarray, "*batch 3"],
    c: Float[np.ndarray, "*batch 3"],
    d: Float[np.ndarray, "*batch 3"],
) -> tuple[Float[np.ndarray, "*batch 2"], Float[np.ndarray, "*batch 3"]]:
    """Return the nearest points of the segments a to b and c to d, as fractions (..., 2), and the vector between them.

    The vector points from the second segment to the first. Reference: Ericson 2004, "Real-Time Collision Detection",
    5.1.9.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv = np.maximum((u * u).sum(-1), 1e-12), np.maximum((v * v).sum(-1), 1e-12)
    uv, uw, vw = (u * v).sum(-1), (u * w).sum(-1), (v * w).sum(-1)
    denominator = uu * vv - uv**2
    s = np.where(denominator > 1e-9 * uu * vv, (uv * vw - uw * vv) / np.maximum(denominator, 1e-18), 0.0)
    t = np.clip((np.clip(s, 0.0, 1.0) * uv + vw) / vv, 0.0, 1.0)
    s = np.clip((t * uv - uw) / uu, 0.0, 1.0)
    return np.stack([s, t], axis=-1), w + s[..., None] * u - t[..., None] * v
