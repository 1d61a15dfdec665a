"""Hands that touch each other, by palms or fingertips: kept together on a figure of other proportions."""

from __future__ import annotations

import numpy as np

from ..._exchange.rigs.roles import SIDES
from .figures import Actor, Target
from .hand_places import HandPlace, fade, hand_places

_TOUCH, _APART = (0.25, 0.45, 0.7), (0.5, 0.8, 1.1)
"""Distances by the length of the palm up to which two places of the hands touch, and from which they do not: of two
fingertips, of a fingertip and the middle of a palm, and of two palms, which lie on each other turned and moved."""


def keep_hands_together(
    actor: Actor, target: Target, turns: np.ndarray, goals: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return where wrists belong once places that touch are as far from each other as the actor's, by the hands' size.

    Each hand moves by half of the gap, which is the mean over the pairs of places that touch. Between touching and not,
    the gap fades.

    Args:
        actor: the motion.
        target: the rig.
        turns: (N, F, 3, 3) rotations of its controls.
        goals: (F, 3) by role, hands among them.
    """
    places = list(hand_places(actor, target, turns, goals))
    lefts, rights = ([place for place in places if place.side == side] for side in SIDES)
    if not lefts or not rights:
        return goals
    way, total = np.zeros((actor.num_frames, 3)), np.zeros(actor.num_frames)
    for left in lefts:
        for right in rights:
            share, off = _apart(left, right)
            way += share[:, None] * off
            total += share
    way /= 2.0 * np.maximum(total, 1.0)[:, None]
    left, right = lefts[0].role, rights[0].role
    return goals | {left: goals[left] + way, right: goals[right] - way}


def _apart(left: HandPlace, right: HandPlace) -> tuple[np.ndarray, np.ndarray]:
    """Return how far two places touch (F,), and the vector (F, 3) between them that the target lacks."""
    size, own_size = (left.size + right.size) / 2, (left.own_size + right.own_size) / 2
    palms = int(left.is_palm) + int(right.is_palm)
    between = left.place - right.place
    share = 1.0 - fade(np.linalg.norm(between, axis=-1) / size, _TOUCH[palms], _APART[palms])
    return share, own_size / size * between - (left.own - right.own)
