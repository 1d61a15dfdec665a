"""Palms of the actor and of the target: where their middles are, and how far they touch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ..._exchange.rigs.roles import JOINT_OF, SIDES
from .figures import Actor, Target

_HAND_AFTER_WRIST = 2
"""Joints of SMPL from a wrist to its hand: both wrists come before both hands."""


@dataclass(frozen=True)
class Palm:
    """A hand of the actor and of the target over F frames."""

    side: str
    middle: np.ndarray
    """(F, 3) half-way from the actor's wrist to its knuckles."""
    size: float
    """Metres from wrist to knuckles."""
    own: np.ndarray
    """(F, 3) the same place of the target, with its wrist where it belongs so far."""
    own_size: float

    @property
    def role(self) -> str:
        """Role of the hand."""
        return f"{self.side}_hand"


def palms_of(actor: Actor, target: Target, turns: np.ndarray, goals: Mapping[str, np.ndarray]) -> Iterator[Palm]:
    """Yield the hands that have a goal and a length.

    Args:
        actor: the motion.
        target: the rig.
        turns: (N, F, 3, 3) rotations of its controls.
        goals: (F, 3) by role: where wrists belong so far.
    """
    for side in SIDES:
        role = f"{side}_hand"
        if role not in goals:
            continue
        wrist, control = JOINT_OF[role], target.index(role)
        reach = actor.rest[wrist + _HAND_AFTER_WRIST] - actor.rest[wrist]
        theirs = target.ends[control] - target.heads[control]
        size, own_size = float(np.linalg.norm(reach)), float(np.linalg.norm(theirs))
        if size > 0.0 and own_size > 0.0:  # where nothing shows the knuckles it is NaN
            middle = actor.joints[:, wrist] + actor.turns[:, wrist] @ (reach / 2)
            yield Palm(side, middle, size, goals[role] + turns[control] @ (theirs / 2), own_size)


def fade(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return 0 below ``low``, 1 above ``high``, and ``3 x^2 - 2 x^3`` of the share x between."""
    x = np.clip((value - low) / (high - low), 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
