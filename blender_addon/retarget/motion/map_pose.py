"""The map pose: how each bone of a rig must turn from its rest to stand as our body does at rest.

Bones are compared by what they are on a person, never by their axes: a limb's direction, and the side to which its
hinge bends. Trunk and head keep their posture, feet stay flat, hands follow their forearm.
"""

from __future__ import annotations

import numpy as np

from ..._exchange.so3 import matrix_from_quat, quat_from_matrix
from ..maps.roles import JOINT_OF, LIMBS
from .figures import Target

_LEFT, _FORWARD, _UP = np.eye(3)[0], -np.eye(3)[1], np.eye(3)[2]
_BENT = np.sin(np.radians(8.0))
"""Sine of a hinge's rest angle from which the plane of its bones tells its axis."""
_LIKELY = 0.5
"""Cosine between that axis and anatomy's from which it is believed."""
_BALL_BEFORE_ANKLE = 1.5
"""How far the ball of the foot lies before the ankle, by the ankle's height (our body: 1.5)."""


def map_pose(target: Target, actor_rest: np.ndarray, given: dict[str, tuple[float, ...]]) -> np.ndarray:
    """Return the (N, 3, 3) rotations A of the map pose on the target's stage.

    With anatomical frames M (direction, hinge, and what is square to both), ``A = M_actor M_target^T``.

    Args:
        target: the rig.
        actor_rest: (24, 3) joints of the actor at rest.
        given: rotations wxyz in the armature's axes by bone, which count instead where they are.
    """
    A = np.broadcast_to(np.eye(3), (len(target.names), 3, 3)).copy()
    for limb, roles in LIMBS.items():
        upper, lower, end = (target.index(role) for role in roles)
        if min(upper, lower, end) >= 0:
            _align_limb(A, target, actor_rest, (upper, lower, end), limb)
    for c, name in enumerate(target.names):
        if name in given:
            S = target.R_stage_armature
            A[c] = S @ matrix_from_quat(np.array(given[name])) @ S.T
    return A


def map_pose_values(target: Target, A: np.ndarray) -> dict[str, tuple[float, float, float, float]]:
    """Return a map pose as it is kept in a map: quaternions wxyz in the armature's axes by bone."""
    S = target.R_stage_armature
    return {
        name: tuple(np.round(quat_from_matrix(S.T @ turn @ S), 7).tolist())
        for name, turn in zip(target.names, A, strict=True)
    }


def foot_ball(target: Target, foot: int) -> np.ndarray:
    """Return the (3,) rest place of the ball of a foot, straight before the ankle where nothing shows it."""
    if np.isfinite(target.ends[foot]).all():
        return target.ends[foot]
    return target.heads[foot] + _BALL_BEFORE_ANKLE * target.heads[foot, 2] * _FORWARD


def _align_limb(A: np.ndarray, target: Target, rest: np.ndarray, bones: tuple[int, int, int], limb: str) -> None:
    upper, lower, end = bones
    joints = [JOINT_OF[target.roles[bone]] for bone in bones]
    points, own = target.heads[list(bones)], rest[joints]
    is_arm = limb.endswith("arm")
    for bone, here, there in ((upper, (0, 1), own[1] - own[0]), (lower, (1, 2), own[2] - own[1])):
        direction = points[here[1]] - points[here[0]]
        A[bone] = (
            limb_frame(there, anatomical_axis(there, is_arm))
            @ limb_frame(direction, _hinge(points, direction, is_arm)).T
        )
    if is_arm:
        reach = rest[joints[2] + 2] - own[2]  # SMPL's hand joint lies two after its wrist
        hand = target.ends[end] - target.heads[end]
        A[end] = _swing(A[lower] @ hand, reach) @ A[lower] if np.isfinite(hand).all() else A[lower]
        return
    heading = _flat(foot_ball(target, end) - target.heads[end])
    wanted = _flat(rest[joints[2] + 3] - own[2])  # and the ball of the foot three after its ankle
    A[end] = limb_frame(wanted, _UP) @ limb_frame(heading, _UP).T
    toe = target.index(target.roles[end].replace("foot", "toe"))
    if toe >= 0:
        A[toe] = A[end]


def anatomical_axis(direction: np.ndarray, is_arm: bool) -> np.ndarray:
    """Return the axis about which a straight limb bends: elbows forward, knees to the left for a right-handed turn."""
    return np.cross(direction, _FORWARD) if is_arm else _LEFT


def _hinge(points: np.ndarray, direction: np.ndarray, is_arm: bool) -> np.ndarray:
    """Return the axis of a limb's hinge at rest: that of its bend if it is bent, else anatomy's."""
    u, v = points[1] - points[0], points[2] - points[1]
    bend, expected = np.cross(u, v), anatomical_axis(direction, is_arm)
    size = np.linalg.norm(bend)
    if size < _BENT * np.linalg.norm(u) * np.linalg.norm(v):
        return expected
    return bend if bend @ expected > _LIKELY * size * np.linalg.norm(expected) else expected


def limb_frame(direction: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the (..., 3, 3) right-handed frame: a direction, an axis made square to it, and what is square to both.

    Args:
        direction: (..., 3), not zero.
        axis: (..., 3); any other where it lies along the direction.
    """
    x = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    y = axis - (axis * x).sum(-1, keepdims=True) * x
    other = np.eye(3)[np.abs(x).argmin(-1)]
    other = other - (other * x).sum(-1, keepdims=True) * x
    length = np.linalg.norm(y, axis=-1, keepdims=True)
    y = np.where(length < 1e-6, other, y)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _flat(direction: np.ndarray) -> np.ndarray:
    """Return the level part of a direction, forward where it has none."""
    level = direction * [1.0, 1.0, 0.0]
    return level if np.linalg.norm(level) > 1e-4 else _FORWARD


def _swing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotation from one direction to another."""
    axis = np.cross(a, b)
    return limb_frame(b, axis) @ limb_frame(a, axis).T
