"""Compute the map pose: the rotation of each rig bone from its rest to the rest pose of the add-on's body.

Bones are compared by anatomy and not by their axes: by the direction of a limb, and by the bending direction of its
hinge. Trunk and head keep their posture unless they lean, feet remain flat, and hands follow the forearm. Limb lengths
determine the scale.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..._exchange.rigs.rest_frames import UP, level, limb_frame, limb_turns, swing
from ..._exchange.rigs.skeleton import JOINT_OF, LIMBS, SIDES
from ..._exchange.so3 import matrix_from_quat, quat_from_matrix
from ...errors import TargetUnsuitable
from .figures import Actor, Target, foot_ball
from .limbs import trunk_ends

LEANS_DEG = 20.0
"""Smallest lean of the trunk in degrees that is corrected. Curved spines and proportions cause up to 10 degrees."""


def map_pose(target: Target, actor_rest: np.ndarray, given: Mapping[str, tuple[float, ...]]) -> np.ndarray:
    """Return each control's rotation (N, 3, 3) from the rig's rest pose to the actor's: ``M_actor M_target^T``.

    M_actor and M_target are rest frames along the same bone. Quaternions (wxyz) in ``given`` (by bone name) take
    precedence.
    """
    A = np.broadcast_to(np.eye(3), (len(target.names), 3, 3)).copy()
    _straighten(A, target)
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
    """Convert a map pose to its stored form: a quaternion (wxyz) per bone in the armature's axes."""
    S = target.R_stage_armature
    return {
        name: tuple(np.round(quat_from_matrix(S.T @ turn @ S), 7).tolist())
        for name, turn in zip(target.names, A, strict=True)
    }


def lean_at_rest_deg(target: Target) -> float:
    """Return the angle in degrees between up and the direction from hips to neck at rest.

    It is 0 if the rig has neither neck nor head, and lacks an upper arm. It is also 0 if the lowest spine bone is
    upright, because a hunched back is a posture.
    """
    bones, roles = {role: c for c, role in enumerate(target.roles)}, set(target.roles)
    if not roles & {"neck_1", "head"} and not roles >= {f"{side}_upper_arm" for side in SIDES}:
        return 0.0
    lean = _angle_deg(_trunk_way(target))
    spine = [target.heads[bones[role]] for role in ("spine_1", "spine_2") if role in bones]
    lowest = _angle_deg(np.subtract(*spine[::-1])) if len(spine) == 2 else lean
    return lean if lowest > LEANS_DEG else 0.0


def _straighten(A: np.ndarray, target: Target) -> None:
    """Rotate a leaning trunk upright, together with the collars and with a leaning neck and head."""
    if lean_at_rest_deg(target) <= LEANS_DEG:
        return
    trunk = _trunk_way(target)
    upright, head = swing(trunk, UP), target.index("head")
    neck = target.heads[head] - trunk_ends(target)[1] if head >= 0 else trunk
    leans = _angle_deg(upright @ neck) < _angle_deg(neck)
    for c, role in enumerate(target.roles):
        is_trunk = role == "pelvis" or role.startswith("spine_") or role.endswith("_clavicle")
        if is_trunk or (leans and (role == "head" or role.startswith("neck_"))):
            A[c] = upright


def _trunk_way(target: Target) -> np.ndarray:
    base, top, _ = trunk_ends(target)
    return top - base


def _angle_deg(way: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.hypot(way[0], way[1]), way[2])))


def _align_straight(A: np.ndarray, target: Target, rest: np.ndarray, bones: tuple[int, int], limb: str) -> None:
    """Align a limb that has no hand or foot as if it were straight, because bone tails are unreliable."""
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
        reach = rest[joints[2] + 2] - own[2]  # the number of SMPL's hand joint is that of its wrist plus two
        hand = target.ends[end] - target.heads[end]
        A[end] = swing(A[lower] @ hand, reach) @ A[lower] if np.isfinite(hand).all() else A[lower]
        return
    heading = level(foot_ball(target, end) - target.heads[end])
    wanted = level(rest[joints[2] + 3] - own[2])  # the number of the ball is that of its ankle plus three
    A[end] = limb_frame(wanted, UP) @ limb_frame(heading, UP).T
    toe = target.index(target.roles[end].replace("foot", "toe"))
    if toe >= 0:
        A[toe] = A[end]


_APART = 2.0
"""Largest ratio between the legs' relative size and the arms' and trunk's. A toddler's legs are 0.75 of an adult's
relative to the trunk (Snyder et al. 1977), and stylised characters have 0.5."""
_ANY_UNIT = 2000.0  # Largest size ratio of two figures, even if one is in metres and the other in millimetres.


@dataclass(frozen=True)
class Proportions:
    """Lengths between rest joints, relative to the actor's lengths. NaN if a joint is missing."""

    legs: float  # Hip to knee to ankle.
    arms: float  # Shoulder to elbow to wrist.
    trunk: float  # Midpoint of the hips to midpoint of the shoulders.

    def describe(self) -> str:
        """Return a text with the known ratios, such as "legs 0.980, arms 1.020"."""
        return ", ".join(f"{name} {value:.3f}" for name, value in vars(self).items() if np.isfinite(value))


def measure_proportions(actor: Actor, target: Target) -> Proportions:
    """Return the lengths of a rig's limbs and trunk relative to the actor's, with both sides combined."""
    return Proportions(_limbs(actor, target, "leg"), _limbs(actor, target, "arm"), _trunk(actor, target))


def scale_of(proportions: Proportions) -> float:
    """Return a rig's size relative to the actor: the ratio of the legs, or else the median of the other ratios.

    Raises ``TargetUnsuitable`` if no ratio is plausible.
    """
    known = [value for value in vars(proportions).values() if np.isfinite(value)]
    if known and not 1 / _ANY_UNIT <= np.median(known) <= _ANY_UNIT:
        hint = "One of the two may use another unit. Set the scale of the armature."
        raise TargetUnsuitable(f"The rig is {np.median(known):.3g} times as large as the actor.", hint=hint)
    others = [value for value in (proportions.arms, proportions.trunk) if np.isfinite(value)]
    if not np.isfinite(proportions.legs):
        if not others:
            hint = "Map both thighs, shins and feet, or one whole arm."
            raise TargetUnsuitable("The map has no complete limb to measure the size of the rig.", hint=hint)
        return float(np.median(others))
    if others and not 1 / _APART <= proportions.legs / np.median(others) <= _APART:
        hint = "Correct roles with a wrong bone. If the character really has these proportions, set the scale."
        message = f"The rig's size is ambiguous. Relative to the actor, its lengths are {proportions.describe()}."
        raise TargetUnsuitable(message, hint=hint)
    return proportions.legs


def length(points: np.ndarray) -> float:
    """Return the length of a polyline through (P, 3) points."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _limbs(actor: Actor, target: Target, kind: str) -> float:
    own, theirs = 0.0, 0.0
    for side in SIDES:
        roles = LIMBS[f"{side}_{kind}"]
        bones = [target.index(role) for role in roles]
        if min(bones) >= 0:
            own += length(target.heads[bones])
            theirs += length(actor.rest[[JOINT_OF[role] for role in roles]])
    return own / theirs if theirs else float("nan")


def _trunk(actor: Actor, target: Target) -> float:
    ends = []
    for part in ("thigh", "upper_arm"):
        roles = [f"{side}_{part}" for side in SIDES]
        bones = [target.index(role) for role in roles]
        if min(bones) < 0:
            return float("nan")
        ends.append((target.heads[bones].mean(0), actor.rest[[JOINT_OF[role] for role in roles]].mean(0)))
    own, theirs = (float(np.linalg.norm(ends[1][k] - ends[0][k])) for k in range(2))
    return own / theirs
