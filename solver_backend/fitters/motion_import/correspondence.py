"""What a foreign skeleton's joints determine of ours: places, and rotations from a pose in which both stand alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS, NUM_JOINTS
from solver_backend.exchange.rigs.rest_frames import UP, level, limb_frame, limb_turns, stage_axes, swing
from solver_backend.exchange.rigs.roles import JOINT_OF, LIMBS, SIDES, chain_roles
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types import SkeletonMotion

R_STAGE_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation of the body's rest axes (Y up, facing +Z) to the stage's (Z up, facing -Y)."""
NUM_TURNED = 1 + NUM_BODY_JOINTS
"""Joints that are measured: all but SMPL's two hand joints."""
_SPINE = SMPL.numbers("spine1", "spine2", "spine3")
_NECK, _HEAD = SMPL.numbers("neck", "head")
_BALL_AFTER_ANKLE, _HAND_AFTER_WRIST = 3, 2


@dataclass(frozen=True)
class Measured:
    """What is known of our joints; world, metres."""

    places: np.ndarray
    """(F, NUM_JOINTS, 3), NaN where the skeleton has no such joint."""
    turns: np.ndarray
    """(F, 22, 3, 3) rotations from our body's rest axes to the world."""
    rest: np.ndarray
    """(NUM_JOINTS, 3) the skeleton's joints at rest, NaN where it has none."""


def measure(motion: SkeletonMotion, roles: dict[str, str], own_rest: np.ndarray) -> Measured:
    """Return places and rotations of our joints as the skeleton has them.

    With G the rotation of a joint since the skeleton's rest, R_s that of its rest axes to the stage, R_b that of ours
    and A what brings the bone at rest to ours, our rotation is ``G R_s^T A^T R_b``: a bone points where theirs does.

    Args:
        motion: the skeleton's motion.
        roles: its joint by role.
        own_rest: (NUM_JOINTS, 3) joints of our body at rest, Y up.

    Raises:
        MotionInvalid: left and right are not known.
    """
    index = {role: motion.names.index(name) for role, name in roles.items()}
    R = stage_axes({role: motion.rest[j] for role, j in index.items()})
    if R is None:
        hint = "Both thighs or both upper arms must be there."
        raise MotionInvalid("The skeleton's left and right are not known.", where=motion.name, hint=hint)
    places, rest = np.full((motion.num_frames, NUM_JOINTS, 3), np.nan), np.full((NUM_JOINTS, 3), np.nan)
    for role, joint in JOINT_OF.items():
        if role in index and role != "pelvis" and not role.endswith("clavicle"):
            places[:, joint], rest[joint] = motion.joints[:, index[role]], motion.rest[index[role]]
    aligned = _alignments(index, motion.rest @ R.T, own_rest @ R_STAGE_BODY.T)
    G = {role: motion.turns[:, j] @ R.T @ aligned.get(role, np.eye(3)).T @ R_STAGE_BODY for role, j in index.items()}
    return Measured(places, _turns(G, motion.num_frames), rest)


def _alignments(index: dict[str, int], rest: np.ndarray, own: np.ndarray) -> dict[str, np.ndarray]:
    """Return the rotation by role that brings a bone from the skeleton's rest to ours, both on the stage."""
    aligned: dict[str, np.ndarray] = {}
    for limb, roles in LIMBS.items():
        if not set(roles[:2]) <= index.keys():
            continue
        side, is_arm = limb.partition("_")[0], limb.endswith("arm")
        joints = [JOINT_OF[role] for role in roles]
        first, second = rest[index[roles[0]]], rest[index[roles[1]]]
        # Without hand or foot the limb is taken to be straight at rest.
        end = rest[index[roles[2]]] if roles[2] in index else 2 * second - first
        points = np.stack([first, second, end])
        upper, lower = limb_turns(points, own[joints], is_arm)
        aligned |= {roles[0]: upper, roles[1]: lower, roles[2]: lower}
        if roles[2] not in index:
            continue
        if is_arm:
            knuckles = [
                index[f"{side}_{f}_1"] for f in ("index", "middle", "ring", "pinky") if f"{side}_{f}_1" in index
            ]
            if knuckles:
                reach = own[joints[2] + _HAND_AFTER_WRIST] - own[joints[2]]
                aligned[roles[2]] = swing(lower @ (rest[knuckles].mean(0) - points[2]), reach) @ lower
        elif f"{side}_toe" in index:
            heading = level(lower @ (rest[index[f"{side}_toe"]] - points[2]))
            wanted = level(own[joints[2] + _BALL_AFTER_ANKLE] - own[joints[2]])
            aligned[roles[2]] = limb_frame(wanted, UP) @ limb_frame(heading, UP).T @ lower
            aligned[f"{side}_toe"] = aligned[roles[2]]
    return aligned


def _turns(G: dict[str, np.ndarray], frames: int) -> np.ndarray:
    """Return (F, 22, 3, 3): what the skeleton has, and between neighbours what it lacks."""
    turns = np.empty((frames, NUM_TURNED, 3, 3))
    turns[:, 0] = G["pelvis"]
    spine = [G[role] for role in chain_roles(dict.fromkeys(G, ""), "spine")]
    line = [turns[:, 0], *spine]
    for k, joint in enumerate(_SPINE):
        turns[:, joint] = _along(line, (k + 1) / len(_SPINE))
    chest = turns[:, _SPINE[-1]]
    turns[:, _HEAD] = G.get("head", chest)
    necks = [G[role] for role in chain_roles(dict.fromkeys(G, ""), "neck")]
    turns[:, _NECK] = _along(necks, 0.5) if necks else _along([chest, turns[:, _HEAD]], 0.5)
    for side in SIDES:
        above = {"clavicle": chest, "upper_arm": None, "forearm": None, "hand": None}
        above |= {"thigh": turns[:, 0], "shin": None, "foot": None, "toe": None}
        last = chest
        for part, start in above.items():
            last = G.get(f"{side}_{part}", start if start is not None else last)
            turns[:, JOINT_OF[f"{side}_{part}"]] = last
    return turns


def _along(line: list[np.ndarray], share: float) -> np.ndarray:
    """Return the rotation at a share of a chain of them, by the geodesic between neighbours."""
    at = share * (len(line) - 1)
    low = min(int(at), len(line) - 1)
    if at - low < 1e-9 or low + 1 >= len(line):
        return line[low]
    step = log_so3(np.swapaxes(line[low], -1, -2) @ line[low + 1])
    return line[low] @ exp_so3((at - low) * step)
