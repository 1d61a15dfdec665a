"""Move limbs, feet, trunks and fingers to target positions, in all frames at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from ..._exchange.body_layout import SMPL
from ..._exchange.limb_bend import eased
from ..._exchange.rigs.rest_frames import FORWARD
from ..._exchange.rigs.rest_frames import swing as turn_directions
from ..._exchange.rigs.skeleton import FINGERS, JOINT_OF, SIDES
from ..._exchange.so3 import matrix_from_rotvec, rotvec_from_matrix
from ..._exchange.stands import SPEED_M_S, standing_runs, steps
from .figures import Actor, Hand, Target, Trunk, foot_ball

_BALL_AFTER_ANKLE = 3  # SMPL joint number of the foot joint (the ball) minus that of the ankle.
_PERSON_LEG_M = 0.81  # Distance from hip to ankle of the add-on's body. Limits in metres scale with the leg length.
_SLIDE_M = 0.03  # Largest distance between a planted foot and its median position, in metres.
_TURN_DEG = 11.0  # Largest angle between a planted foot and its mean direction. It moves an ankle that far too.
_SLOWER = 1.25 * 0.8 ** np.arange(8)
"""Fractions of a planted foot's speed limit, tried until its slide is small enough. Larger feet move faster."""
_EASE_S = 0.15  # Time in which a foot returns from a contact to its original path, in seconds.


@dataclass(frozen=True)
class FootPath:
    """Path of one of the target's feet over F frames."""

    role: str
    sole: np.ndarray  # (F, 3) point on the floor below the ball of the planted foot.
    turns: np.ndarray  # (F, 3, 3) rotation of the foot from rest.
    own: np.ndarray  # (3,) vector from the sole point to the ankle at rest.
    size: float = 1.0  # Leg length of the scaled actor relative to the add-on's body.

    @property
    def ankle(self) -> np.ndarray:
        """Ankle positions (F, 3) in metres."""
        return self.sole + self.turns @ self.own


def foot_paths(actor: Actor, target: Target, turns: np.ndarray, scale: float) -> list[FootPath]:
    """Compute the paths of the target's feet from the paths of the actor's feet.

    The sole point under the ball follows the actor's sole point, scaled. Heel and ankle keep the target's distances
    from this point, so that planted and rolling feet do not slide.
    """
    paths, size = [], scale * leg_m(actor.rest) / _PERSON_LEG_M
    for side in SIDES:
        role = f"{side}_foot"
        foot = target.index(role)
        if foot >= 0:
            ankle = JOINT_OF[role]
            ball = ankle + _BALL_AFTER_ANKLE
            below = actor.rest[ball] * [0.0, 0.0, -1.0]
            sole = scale * (actor.joints[:, ball] + actor.turns[:, ankle] @ below)
            own = target.heads[foot] - foot_ball(target, foot) * [1.0, 1.0, 0.0]
            paths.append(FootPath(role, sole, turns[foot], own, size))
    return paths


def leg_m(rest: np.ndarray) -> float:
    """Return the length in metres of the left leg, from (24, 3) rest joints."""
    return float(np.linalg.norm(np.diff(rest[[1, 4, 7]], axis=0), axis=1).sum())


def steadied(path: FootPath, low: np.ndarray, fps: float) -> FootPath:
    """Fix a foot's path while the foot is planted, and blend with the original path before and after.

    The ball of the foot keeps its median position. A flat foot also keeps its mean direction, so that its ankle does
    not move. If a contact slides by more than 3 cm at a person's size, or rotates by more than 11 degrees, only its
    slower frames are fixed.

    Args:
        low: (F,) mask of the frames with the foot at floor height.
    """

    def to_median(first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        way = np.median(path.sole[first:stop], axis=0) - path.sole[first:stop]
        return way, way / (path.size * _SLIDE_M)

    def to_mean(first: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        R = path.turns[first:stop]
        middle = R[len(R) // 2]
        mean = middle @ matrix_from_rotvec(rotvec_from_matrix(middle.T @ R).mean(axis=0))
        turn = rotvec_from_matrix(mean @ R.swapaxes(-1, -2))
        return turn, turn / np.radians(_TURN_DEG)

    ankle, ball = (_speeds(points / path.size, fps) for points in (path.ankle, path.sole))
    held = _held(low, (ball, np.maximum(ball, ankle)), to_median, fps)
    turned = _held(np.isfinite(held[:, 0]), (ankle,), to_mean, fps)
    sole, turn = (eased(way, np.flatnonzero(np.isfinite(way[:, 0])), _EASE_S * fps) for way in (held, turned))
    return replace(path, sole=path.sole + sole, turns=matrix_from_rotvec(turn) @ path.turns)


def _held(
    allowed: np.ndarray,
    speeds: tuple[np.ndarray, ...],
    hold: Callable[[int, int], tuple[np.ndarray, np.ndarray]],
    fps: float,
) -> np.ndarray:
    """Return the corrections (F, 3) that fix a foot while it is planted, and NaN in other frames.

    ``hold(first, stop)`` returns the corrections of a frame range, and vectors that are longer than 1 if a correction
    is too large. Ranges are separated by the easing time, so that the foot does not jump.
    """
    held, free, gap = np.full((len(allowed), 3), np.nan), allowed.copy(), round(_EASE_S * fps)
    for share, speed in product(_SLOWER, speeds):
        for first, stop in standing_runs(free & (speed < share * SPEED_M_S), fps):
            corrections, moved = hold(first, stop)
            if np.linalg.norm(moved, axis=-1).max() <= 1.0:
                held[first:stop] = corrections
                free[max(first - gap, 0) : stop + gap] = False
    return held


def _speeds(points: np.ndarray, fps: float) -> np.ndarray:
    """Return a point's speeds (F,) in metres per second, averaged over a few frames to reduce noise."""
    way, seconds = steps(points[:, None], fps)
    return np.linalg.norm(way[:, 0], axis=-1) / np.maximum(seconds[:, 0], 1e-9)


_SPINE, _HIPS = SMPL.numbers("pelvis", "spine1", "spine2", "spine3"), SMPL.both("hip")
(_NECK,) = SMPL.numbers("neck")


def trunk_of(actor: Actor) -> Trunk:
    """Return the trunk of an actor with SMPL's joints: the pelvis and three spine joints."""
    hips = actor.rest[list(_HIPS)].mean(0)
    points = actor.rest[[*_SPINE, _NECK]]
    heights = _heights((points[:-1] + points[1:]) / 2, hips, actor.rest[_NECK])
    return Trunk(heights, np.stack([actor.turns[:, joint] for joint in _SPINE]))


def rig_trunk(rest: Target, A: np.ndarray, turns: np.ndarray) -> Trunk:
    """Return a rig's trunk from the rotations (N, F, 3, 3) of its bones and its map pose A."""
    line = [rest.index("pelvis"), *_spine(rest)]
    points = np.stack([*rest.heads[line], _top(rest, line[-1])])
    return Trunk(
        _heights((points[:-1] + points[1:]) / 2, hips_of(rest, rest.heads), points[-1]),
        (turns @ A[:, None].swapaxes(-1, -2))[line],
    )


def spine_heights(target: Target) -> Iterator[tuple[int, float]]:
    """Yield each spine bone and the height of its midpoint, or infinity for the top bone."""
    spine = _spine(target)
    if not spine:
        return
    end = _top(target, spine[-1])
    for bone, after in pairwise(spine):
        middle = (target.heads[bone] + target.heads[after]) / 2
        yield bone, float(_heights(middle[None], hips_of(target, target.heads), end)[0])
    yield spine[-1], np.inf


def trunk_ends(target: Target) -> tuple[np.ndarray, np.ndarray, int]:
    """Return both (3,) ends of the trunk at rest in metres, and the index of the chest control."""
    chest = (_spine(target) or [target.index("pelvis")])[-1]
    return hips_of(target, target.heads), _top(target, chest), chest


def turn_at(trunk: Trunk, height: float) -> np.ndarray:
    """Return a trunk's rotation (F, 3, 3) at a given height, interpolated on the geodesic."""
    nodes = trunk.heights
    if len(nodes) == 1 or not height < nodes[-1]:
        return trunk.turns[-1]
    upper = int(np.clip(np.searchsorted(nodes, height), 1, len(nodes) - 1))
    share = np.clip((height - nodes[upper - 1]) / max(nodes[upper] - nodes[upper - 1], 1e-9), 0.0, 1.0)
    return between(trunk.turns[upper - 1], trunk.turns[upper], float(share))


def between(R0: np.ndarray, R1: np.ndarray, share: float) -> np.ndarray:
    """Interpolate between two rotations: ``R0 exp(w log(R0^T R1))``, where w is ``share``."""
    return R0 @ matrix_from_rotvec(share * rotvec_from_matrix(R0.swapaxes(-1, -2) @ R1))


def _heights(points: np.ndarray, base: np.ndarray, end: np.ndarray) -> np.ndarray:
    axis = end - base
    return (points - base) @ axis / (axis @ axis)


def _spine(target: Target) -> list[int]:
    spine = [c for c, role in enumerate(target.roles) if role.startswith("spine_")]
    return sorted(spine, key=lambda c: int(target.roles[c].rpartition("_")[2]))


def hips_of(target: Target, places: np.ndarray) -> np.ndarray:
    """Return the midpoint between the hips, given the positions of all controls."""
    thighs = [target.index(f"{side}_thigh") for side in SIDES]
    return places[thighs].mean(0) if min(thighs) >= 0 else places[target.index("pelvis")]


def _top(target: Target, chest: int) -> np.ndarray:
    for role in ("neck_1", "head"):
        if (top := target.index(role)) >= 0:
            return target.heads[top]
    arms = [c for c in (target.index(f"{side}_upper_arm") for side in SIDES) if c >= 0]
    return target.heads[arms].mean(0) if arms else target.heads[chest] + [0.0, 0.0, 1e-3]


_BONES = 4  # Largest number of bones in a finger: three, and one more in the palm or at the tip.


def hands_of(rest: Target, A: np.ndarray, turns: np.ndarray) -> tuple[Hand, ...]:
    """Return a rig's hands in the rest axes of the add-on's body.

    The bend of a finger bone is ``A D_hand^T D A^T``. D and D_hand are the rotations of the bone and of the hand, and A
    is the hand's map pose.
    """
    hands = []
    for side in SIDES:
        hand, fingers = rest.index(f"{side}_hand"), _fingers(rest, side)
        if hand >= 0 and fingers:
            inner = A[hand] @ turns[hand].swapaxes(-1, -2) @ turns[fingers] @ A[hand].T
            directions = _directions(rest, fingers) @ A[hand].T
            starts = (rest.heads[fingers] - rest.heads[hand]) @ A[hand].T
            hands.append(Hand(tuple(rest.roles[c] for c in fingers), directions, inner, starts))
    return tuple(hands)


def bend_fingers(actor: Actor, target: Target, A: np.ndarray, turns: np.ndarray) -> None:
    """Bend a rig's fingers like the actor's, by changing ``turns`` in place. The hands must already be set.

    A finger's rotation combines the actor's bend B with S, the smallest rotation from the direction of the rig's finger
    at rest to the direction of the actor's finger. A thumb that starts at its hand, as in MotionBuilder clips, has no
    direction, so it only bends.
    """
    for hand in actor.hands:
        control = target.index(f"{hand.roles[0].partition('_')[0]}_hand")
        rows = [row for row, role in enumerate(hand.roles) if target.index(role) >= 0]
        if control >= 0 and rows:
            fingers = [target.index(hand.roles[row]) for row in rows]
            ways = np.stack([_directions(target, fingers) @ A[control].T, hand.directions[rows]])
            S = turn_directions(*np.where(ways.any(axis=-1).all(axis=0)[:, None], ways, FORWARD))
            turns[fingers] = turns[control] @ A[control].T @ hand.bends[rows] @ S[:, None] @ A[control]


def _fingers(target: Target, side: str) -> list[int]:
    roles = (f"{side}_{finger}_{i + 1}" for finger in FINGERS for i in range(_BONES))
    return [target.index(role) for role in roles if target.index(role) >= 0]


def _directions(target: Target, fingers: list[int]) -> np.ndarray:
    places = dict(zip(target.roles, target.heads, strict=True))
    return np.array([_along(places, target.roles[finger]) for finger in fingers])


def _along(places: Mapping[str, np.ndarray], role: str) -> np.ndarray:
    """Return the (3,) unit vector along a finger bone."""
    stem, _, number = role.rpartition("_")
    after, before = (f"{stem}_{int(number) + step}" for step in (1, -1))
    hand = f"{stem.partition('_')[0]}_hand"
    start, end = (role, after) if after in places else (before, role) if before in places else (hand, role)
    way = places[end] - places[start]
    return way / max(float(np.linalg.norm(way)), 1e-12)
