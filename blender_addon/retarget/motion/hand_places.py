"""Places of hands that touch things, of the actor and of the target: the middles of the palms, and the fingertips."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ..._exchange.rigs.roles import FINGERS, JOINT_OF, SIDES
from .figures import Actor, Hand, Target

PALM = "palm"
"""Name of the place that is no fingertip."""
_HAND_AFTER_WRIST = 2
"""Joints of SMPL from a wrist to its hand: both wrists come before both hands."""
_BONES = 3
"""Bones of a finger; what begins after them begins at the tip."""
_LAST_BONE = 0.9
"""Length of a finger's last bone with its pulp by the bone before: 0.6 to 0.8 of the bones (Buryanov and Kotiuk 2010)
and 4 mm of pulp."""


@dataclass(frozen=True)
class HandPlace:
    """A place of a hand, of the actor and of the target, over F frames."""

    side: str
    name: str
    """``PALM`` or the finger."""
    place: np.ndarray
    """(F, 3) of the actor: half-way from its wrist to its knuckles, or the tip of a finger."""
    size: float
    """Metres from the actor's wrist to its knuckles."""
    own: np.ndarray
    """(F, 3) the same place of the target, with its wrist where it belongs so far."""
    own_size: float

    @property
    def role(self) -> str:
        """Role of the hand."""
        return f"{self.side}_hand"

    @property
    def is_palm(self) -> bool:
        """Whether it is the middle of the palm."""
        return self.name == PALM


def hand_places(
    actor: Actor, target: Target, turns: np.ndarray, goals: Mapping[str, np.ndarray]
) -> Iterator[HandPlace]:  # fmt: skip
    """Yield the palms of hands that have a goal and a length, each with the fingertips that both figures have.

    Args:
        actor: the motion.
        target: the rig.
        turns: (N, F, 3, 3) rotations of its controls.
        goals: (F, 3) by role: where wrists belong so far.
    """
    fingers = {hand.roles[0].partition("_")[0]: hand for hand in actor.hands}
    for side in SIDES:
        role = f"{side}_hand"
        if role not in goals:
            continue
        wrist, control = JOINT_OF[role], target.index(role)
        reach = actor.rest[wrist + _HAND_AFTER_WRIST] - actor.rest[wrist]
        theirs = target.ends[control] - target.heads[control]
        size, own_size = float(np.linalg.norm(reach)), float(np.linalg.norm(theirs))
        if not (size > 0.0 and own_size > 0.0):  # where nothing shows the knuckles it is NaN
            continue
        middle = actor.joints[:, wrist] + actor.turns[:, wrist] @ (reach / 2)
        yield HandPlace(side, PALM, middle, size, goals[role] + turns[control] @ (theirs / 2), own_size)
        if side in fingers:
            own_tips = _tips_of_target(target, control, side, turns)
            for finger, tip in _tips_of_actor(fingers[side]).items():
                if finger in own_tips:
                    place = actor.joints[:, wrist] + (actor.turns[:, wrist] @ tip[..., None])[..., 0]
                    yield HandPlace(side, finger, place, size, goals[role] + own_tips[finger], own_size)


def _tips_of_actor(hand: Hand) -> dict[str, np.ndarray]:
    """Return the (F, 3) tips of the fingers from the wrist, in the hand's axes, by finger."""
    tips = {}
    for finger, rows in _rows_by_finger(hand.roles).items():
        start = np.broadcast_to(hand.starts[rows[0]], (hand.bends.shape[1], 3))
        tips[finger] = start + _reach(hand.starts[rows], hand.bends[rows])
    return tips


def _tips_of_target(target: Target, hand: int, side: str, turns: np.ndarray) -> dict[str, np.ndarray]:
    """Return the (F, 3) tips of the fingers from the wrist, by finger."""
    controls = np.array([c for c, role in enumerate(target.roles) if role.startswith(f"{side}_")])
    tips = {}
    for finger, rows in _rows_by_finger(tuple(target.roles[c] for c in controls)).items():
        bones = controls[rows]
        start = turns[hand] @ (target.heads[bones[0]] - target.heads[hand])
        tips[finger] = start + _reach(target.heads[bones], turns[bones])
    return tips


def _reach(starts: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return the (F, 3) way from a finger's knuckle to its tip, where a fourth bone begins or by ``_LAST_BONE``.

    Args:
        starts: (B, 3) where its bones begin at rest.
        turns: (B, F, 3, 3) their rotations since.
    """
    ways = np.diff(starts, axis=0)
    if len(ways) < _BONES:
        ways = np.concatenate([ways, _LAST_BONE * ways[-1:]])
    return np.einsum("bfij,bj->fi", turns[: len(ways)], ways)


def _rows_by_finger(roles: tuple[str, ...]) -> dict[str, list[int]]:
    """Return the bones from the knuckle on of each finger that has at least two."""
    found = dict[str, list[int]]()
    for row in sorted(range(len(roles)), key=roles.__getitem__):
        finger = roles[row].rpartition("_")[0].partition("_")[2]
        if finger in FINGERS:
            found.setdefault(finger, []).append(row)
    return {finger: rows for finger, rows in found.items() if len(rows) > 1}


def fade(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return 0 below ``low``, 1 above ``high``, and ``3 x^2 - 2 x^3`` of the share x between."""
    x = np.clip((value - low) / (high - low), 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
