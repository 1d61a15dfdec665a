"""Find the fingers in another program's skeleton, and compute hand points and finger angles."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from solver_backend.body.hand_skeleton import measure_angles, palm_frames
from solver_backend.exchange.joint_sets import FINGERS, NUM_HAND_POINTS, SIDES
from solver_backend.exchange.rigs.names import finger_roles, side_of_name
from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.skeleton_file import SkeletonMotion
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types.shapes import Float

_BONES = 3  # Bones per finger.
_TIP = 0.8  # Length ratio of the last bone to the one before, if a skeleton ends there (Buryanov and Kotiuk 2010).
_GOES_ON = 0.5  # Ratio of such a bone's bend to that of the previous bone: 0.35 to 0.62 in a relaxed hand.
_FOREARM = 1.35  # Length ratio of forearm to hand (ANSUR II: 0.26 and 0.19 m).
_NEEDED = ("thumb", "index", "middle", "pinky")  # Fingers needed to recognise a hand and the axes of its palm.
MOVES = 0.005  # Smallest finger rotation from rest in radians. Fingers that move less are not part of the motion.


def hands_of_skeleton(motion: SkeletonMotion, side: str = "") -> dict[str, str]:
    """Map finger roles to joint names in a skeleton that consists only of hands.

    ``side`` is ``left`` or ``right`` for a single hand that has no side in its names.
    """
    parents = {n: motion.names[p] for n, p in zip(motion.names, motion.parents, strict=True) if p >= 0}
    skeleton = Skeleton(dict(zip(motion.names, motion.rest, strict=True)), parents)
    roles: dict[str, str] = {}
    for bone, name in enumerate(skeleton.names):
        fingers = finger_roles(skeleton, bone, _FOREARM * skeleton.reach[bone])
        if not all(f"{finger}_{_BONES}" in fingers for finger in _NEEDED):
            continue
        own = side or _side([name, *(skeleton.names[j] for j in fingers.values())])
        if own and f"{own}_hand" not in roles:
            roles |= {f"{own}_hand": name, **{f"{own}_{role}": skeleton.names[j] for role, j in fingers.items()}}
    return roles


def finger_points(motion: SkeletonMotion, roles: Mapping[str, str], side: int) -> Float[np.ndarray, "n 21 3"] | None:
    """Return (F, 21, 3) ``HAND_POINTS`` of one hand (0 left, 1 right), or None if too many joints are missing."""
    name = SIDES[side]
    index = {role: motion.names.index(joint) for role, joint in roles.items() if role.startswith(f"{name}_")}
    if not all(f"{name}_{finger}_{_BONES}" in index for finger in _NEEDED) or f"{name}_hand" not in index:
        return None
    points = np.full((motion.num_frames, NUM_HAND_POINTS, 3), np.nan)
    points[:, 0] = motion.joints[:, index[f"{name}_hand"]]
    for number, finger in enumerate(FINGERS):
        bones = [index.get(f"{name}_{finger}_{k + 1}", -1) for k in range(_BONES)]
        if -1 not in bones:
            first = 1 + 4 * number
            points[:, first : first + _BONES] = motion.joints[:, bones]
            points[:, first + _BONES] = _tip(motion, bones)
    return points


def finger_angles(points: Float[np.ndarray, "n 21 3"], side: int) -> tuple[np.ndarray, np.ndarray]:
    """Measure finger angles (F, A) and palm rotations (F, 3, 3) on (F, 21, 3) hand points."""
    with np.errstate(invalid="ignore"):
        return measure_angles(points, side), palm_frames(points, side)[:, 2]


def fingers_move(motion: SkeletonMotion, roles: Mapping[str, str], side: int) -> bool:
    """Return whether any finger of a hand moves relative to the palm during the take."""
    name = SIDES[side]
    fingers = [f"{name}_{finger}_{k + 1}" for finger in FINGERS for k in range(_BONES)]
    columns = [motion.names.index(roles[role]) for role in fingers if role in roles]
    if not columns or f"{name}_hand" not in roles:
        return False
    palm = motion.turns[:, motion.names.index(roles[f"{name}_hand"])]
    bends = np.swapaxes(palm, -1, -2)[:, None] @ motion.turns[:, columns]
    return bool(np.linalg.norm(log_so3(bends), axis=-1).max() > MOVES)


def _tip(motion: SkeletonMotion, bones: list[int]) -> np.ndarray:
    """Return a fingertip's positions (F, 3). Without a joint at the tip, extrapolate the finger's bones."""
    last = bones[-1]
    ends = [j for j, parent in enumerate(motion.parents) if parent == last]
    ends = [j for j in ends if np.linalg.norm(motion.rest[j] - motion.rest[last]) > 0]
    if ends:
        return motion.joints[:, ends[0]]
    before, along = (_unit(motion.rest[b] - motion.rest[a]) for a, b in pairwise(bones))
    axis = np.cross(before, along)
    sine = float(np.linalg.norm(axis))
    bend = _GOES_ON * np.arctan2(sine, before @ along)
    along = exp_so3(bend * axis / max(sine, 1e-12)) @ along
    # Joints may be in another unit than the rest pose, so the previous bone gives the scale.
    long = np.linalg.norm(motion.joints[:, last] - motion.joints[:, bones[-2]], axis=-1, keepdims=True)
    return motion.joints[:, last] + _TIP * long * (motion.turns[:, last] @ along)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _side(names: list[str]) -> str:
    sides = {side_of_name(name) for name in names} - {""}
    return sides.pop() if len(sides) == 1 else ""
