"""Hands that touch each other: kept together on a figure of other proportions."""

from __future__ import annotations

import numpy as np

from ..._exchange.rigs.roles import JOINT_OF, SIDES
from .figures import Actor, Target

_TOUCH, _APART = 0.7, 1.1
"""Distances of the palms' middles by the length of the palm up to which hands touch, and from which they do not."""
_HAND_AFTER_WRIST = 2
"""Joints of SMPL from a wrist to its hand: both wrists come before both hands."""


def keep_hands_together(
    actor: Actor, target: Target, turns: np.ndarray, goals: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return where wrists belong once palms that touch are as far from each other as the actor's, by the hands' size.

    Each hand takes half of the way. Between touching and not, the way fades.

    Args:
        actor: the motion.
        target: the rig.
        turns: (N, F, 3, 3) rotations of its controls.
        goals: (F, 3) by role, hands among them.
    """
    roles = [f"{side}_hand" for side in SIDES]
    if not set(roles) <= goals.keys():
        return goals
    palms, own, sizes = [], [], []
    for role in roles:
        wrist, control = JOINT_OF[role], target.index(role)
        reach = actor.rest[wrist + _HAND_AFTER_WRIST] - actor.rest[wrist]
        palms.append(actor.joints[:, wrist] + actor.turns[:, wrist] @ (reach / 2))
        size = float(np.linalg.norm(reach))
        theirs = _palm(target, control)
        sizes.append((size, float(np.linalg.norm(theirs))))
        own.append(goals[role] + turns[control] @ (theirs / 2))
    size, own_size = np.mean(sizes, axis=0)
    if min(size, own_size) <= 0.0:
        return goals
    between = palms[0] - palms[1]
    distance = np.linalg.norm(between, axis=-1) / size
    share = np.clip((_APART - distance) / (_APART - _TOUCH), 0.0, 1.0)
    share = (share * share * (3.0 - 2.0 * share))[:, None]
    way = share * (own_size / size * between - (own[0] - own[1])) / 2
    return goals | {roles[0]: goals[roles[0]] + way, roles[1]: goals[roles[1]] - way}


def _palm(target: Target, hand: int) -> np.ndarray:
    """Return the (3,) way from the wrist to the knuckles at rest; zero where nothing shows it."""
    way = target.ends[hand] - target.heads[hand]
    return way if np.isfinite(way).all() else np.zeros(3)
