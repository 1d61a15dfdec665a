"""Hands that touch each other: kept together on a figure of other proportions."""

from __future__ import annotations

import numpy as np

from .figures import Actor, Target
from .palms import fade, palms_of

_TOUCH, _APART = 0.7, 1.1
"""Distances of the palms' middles by the length of the palm up to which hands touch, and from which they do not."""


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
    palms = list(palms_of(actor, target, turns, goals))
    if len(palms) < 2:
        return goals
    left, right = palms
    size, own_size = (left.size + right.size) / 2, (left.own_size + right.own_size) / 2
    between = left.middle - right.middle
    share = 1.0 - fade(np.linalg.norm(between, axis=-1) / size, _TOUCH, _APART)
    way = share[:, None] * (own_size / size * between - (left.own - right.own)) / 2
    return goals | {left.role: goals[left.role] + way, right.role: goals[right.role] - way}
