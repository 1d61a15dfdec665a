"""Describe an actor's motion, and a rig as a tree of controls, both in stage coordinates.

Stage coordinates are in metres with Z up. At rest the soles are at z = 0, and the figure faces -Y with left = +X.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..._exchange.motion_file import MotionFile
from ..._exchange.rigs.rest_frames import FORWARD
from ..._exchange.rigs.skeleton import FINGERS, JOINT_OF, SIDES
from ...body.body_file import BodyFile, pose_joints, rotvec_on, with_own_hands
from ...conventions.coordinates import R_ARMATURE_BODY
from ...conventions.skeleton import SMPL, BodyLayout

_SPINE = (3, 6, 9)  # SMPL's trunk joints from the pelvis up.


def parts_of_joints(layout: BodyLayout, joints: np.ndarray) -> np.ndarray:
    """Return the body part (V,) of each vertex, given the joint (V,) with its largest weight. "" means none."""
    columns, role_at = layout.standing_for(SMPL), {joint: role for role, joint in JOINT_OF.items()}
    parts = [""] * layout.num_joints
    for joint, column in enumerate(columns):
        parts[column] = "trunk" if joint in _SPINE else part_of_role(role_at.get(joint, ""))
    return np.array(parts)[joints]


def by_part(points: np.ndarray, parts: np.ndarray) -> dict[str, np.ndarray]:
    """Group (V, 3) points by their (V,) body part. Points without a part are omitted."""
    return {str(part): points[parts == part] for part in np.unique(parts) if part}


def part_of_role(role: str) -> str:
    """Return the body part of a role's bone, or "" for bones that hands cannot be in contact with."""
    side, _, part = role.partition("_")
    if role in ("pelvis", "head"):
        return "head" if role == "head" else "trunk"
    if role.startswith("spine_") or part == "clavicle":
        return "trunk"
    return role if side in SIDES and part in ("thigh", "shin", "upper_arm", "forearm") else ""


_BONES_OF_A_FINGER = 3
_AT_REST = 0.005
"""If all fingers of a take rotate by less than this (in radians), the motion has no fingers."""


@dataclass(frozen=True)
class Trunk:
    """Heights and rotations of a figure's K trunk bones, from pelvis to chest."""

    heights: np.ndarray  # (K,) heights of the bones' midpoints at rest, from 0 at the hips to 1 at the neck.
    turns: np.ndarray  # (K, F, 3, 3) rotations from rest.


@dataclass(frozen=True)
class Hand:
    """Rest directions and bends of a hand's B finger bones."""

    roles: tuple[str, ...]
    directions: np.ndarray  # (B, 3) directions at rest, in the rest axes of the add-on's body.
    bends: np.ndarray  # (B, F, 3, 3) rotation of each bone from rest, in the hand's axes: ``D_hand^T D``.
    starts: np.ndarray  # (B, 3) vectors in metres from wrist to bone heads at rest, in the same axes.


@dataclass(frozen=True)
class Actor:
    """Motion of the add-on's body, or of another figure after conversion to SMPL's joints."""

    name: str
    rest: np.ndarray  # (24, 3) joints at rest.
    turns: np.ndarray  # (F, 24, 3, 3) rotation of each joint from rest.
    joints: np.ndarray  # (F, 24, 3) joint positions, with the floor at z = 0.
    fps: float
    contacts: np.ndarray | None = None  # (F, 2) bool: contacts of the left and right foot.
    trunk: Trunk | None = None  # Trunk of a figure with other trunk bones than SMPL's, or None.
    hands: tuple[Hand, ...] = ()  # Hands whose fingers the motion includes.
    skin: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(V, 3) skin points at rest for each body part in metres, empty if unknown."""

    @property
    def num_frames(self) -> int:
        """Number F of frames."""
        return len(self.joints)


@dataclass(frozen=True)
class Target:
    """The N controls of a rig that have roles, sorted so that carriers precede the controls they move."""

    names: tuple[str, ...]
    roles: tuple[str, ...]
    heads: np.ndarray  # (N, 3) bone heads in the rest pose.
    ends: np.ndarray  # (N, 3) knuckles for hands and balls for feet in the rest pose, NaN for others and if unknown.
    axes: np.ndarray  # (N, 3, 3) axes in the rest pose, one per matrix column.
    place_axes: np.ndarray  # (N, 3, 3) axes of each control's location channel in the rest pose.
    turns_with: np.ndarray  # (N,) index of the control that rotates each one, or -1.
    moves_with: np.ndarray  # (N,) index of the control that moves each one, or -1.
    R_stage_armature: np.ndarray  # (3, 3) rotation from the armature's axes to the stage's.
    unit_m: float  # Metres per unit of the armature's space.
    ground: np.ndarray  # (3,) vector in metres from the armature's origin to the stage's, in the stage's axes.
    skin: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(V, 3) skin points in the rest pose for each body part in metres, empty if unknown."""

    def index(self, role: str) -> int:
        """Return the index of the control with a role, or -1 if there is none."""
        return self.roles.index(role) if role in self.roles else -1


@dataclass(frozen=True)
class BodyAtRest:
    """The add-on's body at rest, in a given shape."""

    layout: BodyLayout
    joints: np.ndarray  # (J, 3) in the body's axes.
    standing: np.ndarray  # (J, 3) the same joints on the stage.
    skin: np.ndarray  # (V, 3) skin points on the stage.


def body_at_rest(body: BodyFile, betas: np.ndarray) -> BodyAtRest:
    """Return the rest joints and the skin of a body in a (10,) shape."""
    rest, skin = body.rest_joints(betas), body.shaped(betas) @ R_ARMATURE_BODY.T
    sole = np.array([0.0, 0.0, skin[:, 2].min()])
    return BodyAtRest(body.layout, rest, rest @ R_ARMATURE_BODY.T - sole, skin - sole)


def actor_of_motion(motion: MotionFile, body: BodyFile) -> Actor:
    """Return the actor for a motion file that is played on its body."""
    rotvec = rotvec_on(with_own_hands(motion, body), body.layout)
    own = body_at_rest(body, motion.betas)
    actor = actor_of_poses(motion.name, own, rotvec, motion.transl, motion.fps, motion.contacts)
    return replace(actor, skin=by_part(own.skin, parts_of_joints(body.layout, body.weights.argmax(axis=1))))


def actor_of_poses(
    name: str,
    own: BodyAtRest,
    rotvec: np.ndarray,
    transl: np.ndarray,
    fps: float,
    contacts: np.ndarray | None = None,
    *,
    still_fingers: bool = False,
) -> Actor:
    """Return the actor for a body's poses, with (F, 2) foot contacts. ``still_fingers`` includes hands at rest."""
    G, joints = pose_joints(own.joints, rotvec, transl)
    turns, columns = G @ R_ARMATURE_BODY.T, list(own.layout.standing_for(SMPL))
    hands = own_hands(own.layout, own.standing, turns, still=still_fingers)
    return Actor(name, own.standing[columns], turns[:, columns], joints[:, columns], fps, contacts, hands=hands)


def own_hands(layout: BodyLayout, rest: np.ndarray, turns: np.ndarray, *, still: bool = False) -> tuple[Hand, ...]:
    """Return the hands of the add-on's body. Hands that remain at rest are included only if ``still`` is True."""
    index = {joint: j for j, joint in enumerate(layout.joints)}
    hands = []
    for side in SIDES:
        roles = [f"{side}_{finger}_{bone}" for finger in FINGERS for bone in range(1, 1 + _BONES_OF_A_FINGER)]
        joints = np.array([index.get("".join(role.rsplit("_", 1)), -1) for role in roles])
        if (joints < 0).any():
            continue
        # The last bone of a finger continues in the direction of the bone before it.
        starts = joints - (np.arange(len(joints)) % _BONES_OF_A_FINGER == _BONES_OF_A_FINGER - 1)
        ways = rest[starts + 1] - rest[starts]
        ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
        bends = turns[:, [index[f"{side}_wrist"]]].swapaxes(-1, -2) @ turns[:, joints]
        if still or np.abs(bends - np.eye(3)).max() > _AT_REST:
            begin = rest[joints] - rest[index[f"{side}_wrist"]]
            hands.append(Hand(tuple(roles), ways, np.moveaxis(bends, 1, 0), begin))
    return tuple(hands)


_BALL_BEFORE_ANKLE = 1.5  # Distance from ankle to ball, relative to the ankle's height (add-on's body).


def foot_ball(target: Target, foot: int) -> np.ndarray:
    """Return the (3,) rest position of a foot's ball. Default: straight in front of the ankle."""
    if np.isfinite(target.ends[foot]).all():
        return target.ends[foot]
    return target.heads[foot] + _BALL_BEFORE_ANKLE * target.heads[foot, 2] * FORWARD


def carried_places(target: Target, turns: np.ndarray, carrier: int, path: np.ndarray) -> np.ndarray:
    """Return the heads (N, F, 3) of all controls, given the ``path`` (F, 3) of the carrier.

    If control m moves control c, ``p_c = p_m + D_m (r_c - r_m)``, with heads p, rest heads r and rotations D.
    """
    places = np.empty((len(target.names), len(path), 3))
    for c, m in enumerate(target.moves_with):
        if c == carrier:
            places[c] = path
        elif m < 0:
            places[c] = target.heads[c]
        else:
            places[c] = places[m] + turns[m] @ (target.heads[c] - target.heads[m])
    return places
