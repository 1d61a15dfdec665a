"""Convert a rig's motion to SMPL's joints, on a person with the rig's proportions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..._exchange.body_layout import SMPL
from ..._exchange.rigs.skeleton import JOINT_OF, SIDES, chain_roles
from ...conventions.skeleton import PARENTS
from .figures import Actor, Target, Trunk
from .limbs import between, hands_of, leg_m, rig_trunk, turn_at

_SPINE, (_NECK, _HEAD) = SMPL.numbers("spine1", "spine2", "spine3"), SMPL.numbers("neck", "head")
_HIPS = SMPL.both("hip")
_BONES = tuple(
    SMPL.numbers(f"{side}_{start}", f"{side}_{end}")
    for limb in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist"))
    for side in SIDES
    for start, end in pairwise(limb)
)
"""Leg and arm bones as pairs of joint numbers. Every figure has them."""
_STANDING = 0.05  # Largest height of a planted foot's ball above its rest height, relative to the leg length.
_ANKLES, _BALLS, _LOWEST_SHARE = [7, 8], [10, 11], 5.0  # Joint numbers, and percentile of ball heights at the floor.
_UPRIGHT = 0.8  # Smallest height of the hip above a loaded ankle, relative to the leg. A seated person has 0.5.


def actor_of_bones(
    name: str, rest: Target, A: np.ndarray, turns: np.ndarray, places: np.ndarray, own_rest: np.ndarray, fps: float
) -> Actor:
    """Convert the motion of a rig's bones to an actor with SMPL's joints. ``places`` are the bone heads.

    If a bone has rotation D_c from rest and map pose A_c, the joint's rotation is ``D_c A_c^T``. If this actor's motion
    is transferred to a rig with the same rest pose, the rig's bone has rotation D_c again. Missing joints are placed as
    in the add-on's body, scaled by the leg length.
    """
    index = {role: c for c, role in enumerate(rest.roles)}
    own = {role: turns[c] @ A[c].T for role, c in index.items()}
    G = _joint_turns(own, places.shape[1])
    known = {JOINT_OF[role]: places[c] for role, c in index.items() if role in JOINT_OF and role != "pelvis"}
    joints, standing = _joints(known, G, own_rest)
    if _HIPS[0] in known and _HIPS[1] in known:
        # The figure is as high as in its rest pose, whether or not its knees are bent.
        feet = [index[f"{side}_foot"] for side in SIDES if f"{side}_foot" in index]
        at = [JOINT_OF[rest.roles[c]] for c in feet]
        if feet:
            standing = standing + [0.0, 0.0, rest.heads[feet, 2].mean() - standing[at, 2].mean()]
    skin = _skin(rest, A, standing)
    return Actor(name, standing, G, joints, fps, None, rig_trunk(rest, A, turns), hands_of(rest, A, turns), skin)


def _skin(rest: Target, A: np.ndarray, standing: np.ndarray) -> dict[str, np.ndarray]:
    index = {role: c for c, role in enumerate(rest.roles)}
    carried_by = {part: "pelvis" if part == "trunk" else part for part in rest.skin}
    return {
        part: standing[JOINT_OF[role]] + (rest.skin[part] - rest.heads[index[role]]) @ A[index[role]].T
        for part, role in carried_by.items()
        if role in index
    }


def _joint_turns(own: dict[str, np.ndarray], frames: int) -> np.ndarray:
    G = np.empty((frames, len(PARENTS), 3, 3))
    line = np.stack([own["pelvis"], *(own[role] for role in chain_roles(dict.fromkeys(own, ""), "spine"))])
    trunk = Trunk(np.linspace(0.0, 1.0, len(line)), line)
    for k, joint in enumerate((0, *_SPINE)):
        G[:, joint] = turn_at(trunk, k / len(_SPINE))
    G[:, _HEAD] = own.get("head", G[:, _SPINE[-1]])
    necks = [own[role] for role in chain_roles(dict.fromkeys(own, ""), "neck")]
    G[:, _NECK] = necks[0] if necks else between(G[:, _SPINE[-1]], G[:, _HEAD], 0.5)
    role_at = {joint: role for role, joint in JOINT_OF.items()}
    for joint, parent in enumerate(PARENTS):
        if joint not in (0, *_SPINE, _NECK, _HEAD):
            G[:, joint] = own.get(role_at.get(joint, ""), G[:, parent])
    return G


def _joints(known: dict[int, np.ndarray], G: np.ndarray, own_rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint positions (F, 24, 3) in the motion and (24, 3) at rest.

    Joints that are not in ``known`` are placed as in the body at rest ``own_rest``, scaled to the figure's size.
    """
    size = _size(known, own_rest)
    start = next(joint for joint in (1, 2, 16, 17, 15, *known) if joint in known)
    hips = [joint for joint in _HIPS if joint in known] or [start]
    joints, standing = np.empty((len(G), len(PARENTS), 3)), np.empty((len(PARENTS), 3))
    way = size * (own_rest[0] - own_rest[hips].mean(0))
    joints[:, 0] = np.mean([known[joint] for joint in hips], axis=0) + G[:, 0] @ way
    standing[0] = size * own_rest[0]
    for joint, parent in enumerate(PARENTS):
        if parent < 0:
            continue
        offset = size * (own_rest[joint] - own_rest[parent])
        if joint in known:
            joints[:, joint] = known[joint]
            inner = np.swapaxes(G[:, parent], -1, -2) @ (joints[:, joint] - joints[:, parent])[..., None]
            offset = np.median(inner[..., 0], axis=0)
        else:
            joints[:, joint] = joints[:, parent] + G[:, parent] @ offset
        standing[joint] = standing[parent] + offset
    return joints, standing


def _size(known: dict[int, np.ndarray], own_rest: np.ndarray) -> float:
    theirs = own = 0.0
    for a, b in _BONES:
        if a in known and b in known:
            theirs += float(np.median(np.linalg.norm(known[b] - known[a], axis=-1)))
            own += float(np.linalg.norm(own_rest[b] - own_rest[a]))
    return theirs / own if own else 1.0


def find_low_feet(rest: np.ndarray, joints: np.ndarray, contacts: np.ndarray | None = None) -> np.ndarray:
    """Return an (F, 2) mask of the frames with the left and right foot on the floor.

    The ball of a foot on the floor is about as low as at rest, or as low as the lower foot when the figure stands
    upright. With (F, 2) contacts from the solve, only frame ranges that include a contact are returned.
    """
    leg, heights = leg_m(rest), joints[:, _BALLS, 2]
    lower = heights.argmin(axis=1, keepdims=True)
    ball, ankle = (np.take_along_axis(joints[:, feet, 2], lower, axis=1)[:, 0] for feet in (_BALLS, _ANKLES))
    at_rest = (rest[_ANKLES, 2] - rest[_BALLS, 2]).mean()
    flat = np.abs(ankle - ball - at_rest) < _STANDING * leg
    stands = flat & (joints[:, _HIPS, 2].mean(axis=1) - ankle > _UPRIGHT * leg)
    lowest = np.percentile(ball[stands], _LOWEST_SHARE) if stands.any() else 0.0
    low = heights < np.maximum(rest[_BALLS, 2], lowest) + _STANDING * leg
    if contacts is None or not contacts.any():
        return low
    return np.stack([_touching(*feet) for feet in zip(low.T, contacts.T, strict=True)], axis=1)


def _touching(low: np.ndarray, contacts: np.ndarray) -> np.ndarray:
    """Return an (F,) mask of the contact frames and of the low frames adjacent to them."""
    allowed = low | contacts
    number = np.cumsum(np.diff(allowed, prepend=False))
    return allowed & np.isin(number, number[contacts])
