"""Feet: where the ball of each foot goes, held where it stands, and the ankle that follows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._exchange.rigs.roles import JOINT_OF, SIDES
from .figures import Actor, Target
from .map_pose import foot_ball

_BALL_AFTER_ANKLE = 3
"""SMPL's foot joint, the ball, stands three after its ankle."""
_STILL_M_S, _SLIDE_M, _HOLD_M, _EASE_S = 0.25, 0.04, 0.008, 0.15
"""A foot that stands is slower than this; one that goes farther slides; it is held by so much at most, which fades in
this time once it leaves."""


@dataclass(frozen=True)
class FootPath:
    """What one foot of the target does."""

    role: str
    sole: np.ndarray
    """(F, 3) the point on the floor under the ball of the standing foot."""
    ankle_from_sole: np.ndarray
    """(F, 3) the vector from there to the ankle."""

    @property
    def ankle(self) -> np.ndarray:
        """(F, 3) where the ankle belongs."""
        return self.sole + self.ankle_from_sole


def foot_paths(actor: Actor, target: Target, turns: np.ndarray, scale: float) -> list[FootPath]:
    """Return the paths of the feet that the target has.

    The point of the sole under the ball follows the actor's, scaled; heel and ankle stand around it in the target's
    own size, so that neither a standing foot nor a rolling one slides.

    Args:
        actor: the motion.
        target: the rig.
        turns: (N, F, 3, 3) rotations of its controls.
        scale: of the target's legs by the actor's.
    """
    paths = []
    for side in SIDES:
        role = f"{side}_foot"
        foot = target.index(role)
        if foot >= 0:
            ankle = JOINT_OF[role]
            ball = ankle + _BALL_AFTER_ANKLE
            below = actor.rest[ball] * [0.0, 0.0, -1.0]
            sole = scale * (actor.joints[:, ball] + actor.turns[:, ankle] @ below)
            own = target.heads[foot] - foot_ball(target, foot) * [1.0, 1.0, 0.0]
            paths.append(FootPath(role, sole, turns[foot] @ own))
    return paths


def steadied(path: FootPath, stands: np.ndarray, fps: float) -> FootPath:
    """Return a path that is level and still while the foot stands, and eased back to its own between.

    Args:
        path: the foot.
        stands: (F,) bool.
        fps: frames per second.
    """
    level = path.sole[:, :2]
    speed = np.linalg.norm(np.gradient(level, axis=0), axis=1) * fps if len(level) > 1 else np.zeros(1)
    held = np.zeros_like(level)
    for first, stop in _runs(stands & (speed < _STILL_M_S)):
        where = np.median(level[first:stop], axis=0)
        apart = where - level[first:stop]
        far = np.linalg.norm(apart, axis=1, keepdims=True)
        if far.max() <= _SLIDE_M:
            held[first:stop] = apart * np.minimum(1.0, _HOLD_M / np.maximum(far, 1e-9))
    fixed = np.flatnonzero(held.any(axis=1))
    if not len(fixed):
        return path
    sole = path.sole.copy()
    sole[:, :2] += eased(held, fixed, _EASE_S * fps)
    return replace(path, sole=sole)


def eased(held: np.ndarray, fixed: np.ndarray, frames: float) -> np.ndarray:
    """Return offsets that are as given on the fixed frames and fade between them, those before and after adding up.

    Args:
        held: (F, n) offsets.
        fixed: frames on which they hold; the others count as 0 where there are none.
        frames: in which they fade.
    """
    if not len(fixed):
        return np.zeros_like(held)
    index = np.arange(len(held))
    after = np.searchsorted(fixed, index, side="left").clip(max=len(fixed) - 1)
    before = (np.searchsorted(fixed, index, side="right") - 1).clip(min=0)
    share = [_smoothstep(1.0 - np.abs(index - fixed[near]) / (frames + 1)) for near in (before, after)]
    total = np.maximum(share[0] + share[1], 1.0)
    faded = (share[0] / total)[:, None] * held[fixed[before]] + (share[1] / total)[:, None] * held[fixed[after]]
    faded[fixed] = held[fixed]
    return faded


def _smoothstep(t: np.ndarray) -> np.ndarray:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _runs(mask: np.ndarray) -> np.ndarray:
    """Return (R, 2) first frames and ends of what is true."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)])
