"""The map pose: the rotation of each bone of a rig from its rest to the pose of our body at rest.

Bones are compared by their anatomy, never by their axes: a limb's direction, and the side to which its hinge bends.
Trunk and head keep their posture, feet stay flat, hands follow their forearm.
"""

from __future__ import annotations

import numpy as np

from ..._exchange.rigs.rest_frames import FORWARD, UP, level, limb_frame, limb_turns, swing
from ..._exchange.rigs.skeleton import JOINT_OF, LIMBS
from ..._exchange.so3 import matrix_from_quat, quat_from_matrix
from .figures import Target

_BALL_BEFORE_ANKLE = 1.5  # Distance of the ball of the foot before the ankle, by the ankle's height (1.5 for our body).


def map_pose(target: Target, actor_rest: np.ndarray, given: dict[str, tuple[float, ...]]) -> np.ndarray:
    """Return the (N, 3, 3) rotations A of the map pose on the target's stage.

    With anatomical frames M (direction, hinge, and their normal), ``A = M_actor M_target^T``. Rotations wxyz ``given``
    in the armature's axes by bone replace those.
    """
    A = np.broadcast_to(np.eye(3), (len(target.names), 3, 3)).copy()
    for limb, roles in LIMBS.items():
        upper, lower, end = (target.index(role) for role in roles)
        if min(upper, lower, end) >= 0:
            _align_limb(A, target, actor_rest, (upper, lower, end), limb)
        elif min(upper, lower) >= 0:
            _align_straight(A, target, actor_rest, (upper, lower), limb)
    for c, name in enumerate(target.names):
        if name in given:
            S = target.R_stage_armature
            A[c] = S @ matrix_from_quat(np.array(given[name])) @ S.T
    return A


def map_pose_values(target: Target, A: np.ndarray) -> dict[str, tuple[float, float, float, float]]:
    """Return a map pose as stored in a map: quaternions wxyz in the armature's axes by bone."""
    S = target.R_stage_armature
    return {
        name: tuple(np.round(quat_from_matrix(S.T @ turn @ S), 7).tolist())
        for name, turn in zip(target.names, A, strict=True)
    }


def foot_ball(target: Target, foot: int) -> np.ndarray:
    """Return the (3,) rest position of the ball of a foot, straight before the ankle if unknown."""
    if np.isfinite(target.ends[foot]).all():
        return target.ends[foot]
    return target.heads[foot] + _BALL_BEFORE_ANKLE * target.heads[foot, 2] * FORWARD


def _align_straight(A: np.ndarray, target: Target, rest: np.ndarray, bones: tuple[int, int], limb: str) -> None:
    """Turn a limb without hand or foot as a straight one, as tails of bones show nothing."""
    first, second = target.heads[list(bones)]
    own = rest[[JOINT_OF[role] for role in LIMBS[limb]]]
    A[bones[0]], A[bones[1]] = limb_turns(np.stack([first, second, 2 * second - first]), own, limb.endswith("arm"))


def _align_limb(A: np.ndarray, target: Target, rest: np.ndarray, bones: tuple[int, int, int], limb: str) -> None:
    upper, lower, end = bones
    joints = [JOINT_OF[target.roles[bone]] for bone in bones]
    points, own = target.heads[list(bones)], rest[joints]
    is_arm = limb.endswith("arm")
    A[upper], A[lower] = limb_turns(points, own, is_arm)
    if is_arm:
        reach = rest[joints[2] + 2] - own[2]  # SMPL's hand joint lies two after its wrist
        hand = target.ends[end] - target.heads[end]
        A[end] = swing(A[lower] @ hand, reach) @ A[lower] if np.isfinite(hand).all() else A[lower]
        return
    heading = level(foot_ball(target, end) - target.heads[end])
    wanted = level(rest[joints[2] + 3] - own[2])  # and the ball of the foot three after its ankle
    A[end] = limb_frame(wanted, UP) @ limb_frame(heading, UP).T
    toe = target.index(target.roles[end].replace("foot", "toe"))
    if toe >= 0:
        A[toe] = A[end]
