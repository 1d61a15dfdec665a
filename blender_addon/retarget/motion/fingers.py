"""Fingers: bent within the hand as the actor's, from wherever they point at rest."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..._exchange.rigs.rest_frames import swing
from ..._exchange.rigs.roles import FINGERS, SIDES
from .figures import Actor, Hand, Target

_BONES = 4
"""Bones of a finger at most: three, and one in the palm or at the tip."""


def hands_of(rest: Target, A: np.ndarray, turns: np.ndarray) -> tuple[Hand, ...]:
    """Return the hands of a rig that plays, in the axes of our body's rest.

    With D the rotations of finger and hand since rest and A the hand's map pose, a bend is
    ``A D_hand^T D A^T``.

    Args:
        rest: N bones at rest, hands before their fingers.
        A: (N, 3, 3) from ``map_pose``.
        turns: (N, F, 3, 3) rotations of the bones since their rest.
    """
    hands = []
    for side in SIDES:
        hand, fingers = rest.index(f"{side}_hand"), _fingers(rest, side)
        if hand >= 0 and fingers:
            inner = A[hand] @ turns[hand].swapaxes(-1, -2) @ turns[fingers] @ A[hand].T
            directions = _directions(rest, fingers) @ A[hand].T
            starts = (rest.heads[fingers] - rest.heads[hand]) @ A[hand].T
            hands.append(Hand(tuple(rest.roles[c] for c in fingers), directions, inner, starts))
    return tuple(hands)


def bend_fingers(actor: Actor, target: Target, A: np.ndarray, turns: np.ndarray) -> None:
    """Turn the fingers of a rig as the actor's bend, in place: ``D = D_hand A^T B S A``.

    B is the actor's bend and S the smallest rotation that makes the finger at rest point as the actor's does.

    Args:
        actor: the motion.
        target: the rig.
        A: (N, 3, 3) from ``map_pose``.
        turns: (N, F, 3, 3) rotations of the controls since their rest; hands are right already.
    """
    for hand in actor.hands:
        control = target.index(f"{hand.roles[0].partition('_')[0]}_hand")
        rows = [row for row, role in enumerate(hand.roles) if target.index(role) >= 0]
        if control >= 0 and rows:
            fingers = [target.index(hand.roles[row]) for row in rows]
            S = swing(_directions(target, fingers) @ A[control].T, hand.directions[rows])
            turns[fingers] = turns[control] @ A[control].T @ hand.bends[rows] @ S[:, None] @ A[control]


def _fingers(target: Target, side: str) -> list[int]:
    roles = (f"{side}_{finger}_{i + 1}" for finger in FINGERS for i in range(_BONES))
    return [target.index(role) for role in roles if target.index(role) >= 0]


def _directions(target: Target, fingers: list[int]) -> np.ndarray:
    """Return the (B, 3) unit vectors along bones of fingers of a rig at rest."""
    places = dict(zip(target.roles, target.heads, strict=True))
    return np.array([_along(places, target.roles[finger]) for finger in fingers])


def _along(places: Mapping[str, np.ndarray], role: str) -> np.ndarray:
    """Return the (3,) unit vector along a bone of a finger: to the next one; of the last, from the one before.

    A finger of one bone points away from the wrist.
    """
    stem, _, number = role.rpartition("_")
    after, before = (f"{stem}_{int(number) + step}" for step in (1, -1))
    hand = f"{stem.partition('_')[0]}_hand"
    start, end = (role, after) if after in places else (before, role) if before in places else (hand, role)
    way = places[end] - places[start]
    return way / max(float(np.linalg.norm(way)), 1e-12)
