"""Proportions: lengths of a rig's legs, arms and trunk by the actor's, and the resulting scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._exchange.rigs.skeleton import JOINT_OF, LIMBS, SIDES
from ...errors import TargetUnsuitable
from .figures import Actor, Target

_APART = 2.0
"""Largest ratio between the size of the legs and that of arms and trunk. A toddler's legs are 0.75 of an adult's by the
trunk (Snyder et al. 1977), those of stylised characters 0.5."""
_ANY_UNIT = 2000.0  # Largest ratio of figures in metres and in millimetres.


@dataclass(frozen=True)
class Proportions:
    """Lengths between joints at rest by the actor's, NaN for missing ones."""

    legs: float  # Hip to knee to ankle.
    arms: float  # Shoulder to elbow to wrist.
    trunk: float  # Middle of the hips to middle of the shoulders.

    def describe(self) -> str:
        """Return the lengths as one line."""
        return ", ".join(f"{name} {value:.3f}" for name, value in vars(self).items() if np.isfinite(value))


def measure_proportions(actor: Actor, target: Target) -> Proportions:
    """Return the lengths of a rig's limbs and trunk by the actor's, both sides together."""
    return Proportions(_limbs(actor, target, "leg"), _limbs(actor, target, "arm"), _trunk(actor, target))


def scale_of(proportions: Proportions) -> float:
    """Return the ratio of the legs or, without legs, the median of the other lengths.

    Raises:
        TargetUnsuitable: the legs are more than twice or less than half of arms and trunk, or the size is absurd.
    """
    known = [value for value in vars(proportions).values() if np.isfinite(value)]
    if known and not 1 / _ANY_UNIT <= np.median(known) <= _ANY_UNIT:
        hint = "Set the scale of its armature: one of the two is built in another unit."
        raise TargetUnsuitable(f"The rig is {np.median(known):.3g} times as large as the actor.", hint=hint)
    others = [value for value in (proportions.arms, proportions.trunk) if np.isfinite(value)]
    if not np.isfinite(proportions.legs):
        if not others:
            hint = "Map both thighs, shins and feet, or one whole arm."
            raise TargetUnsuitable("The rig has no whole limb to measure its size by.", hint=hint)
        return float(np.median(others))
    if others and not 1 / _APART <= proportions.legs / np.median(others) <= _APART:
        hint = "Correct the map where a role has the wrong bone; if the figure is built so, give the scale yourself."
        message = f"The rig's size is not clear: by the actor's, its lengths are {proportions.describe()}."
        raise TargetUnsuitable(message, hint=hint)
    return proportions.legs


def length(points: np.ndarray) -> float:
    """Return the length of a polyline (P, 3)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _limbs(actor: Actor, target: Target, kind: str) -> float:
    own, theirs = 0.0, 0.0
    for side in SIDES:
        roles = LIMBS[f"{side}_{kind}"]
        bones = [target.index(role) for role in roles]
        if min(bones) >= 0:
            own += length(target.heads[bones])
            theirs += length(actor.rest[[JOINT_OF[role] for role in roles]])
    return own / theirs if theirs else float("nan")


def _trunk(actor: Actor, target: Target) -> float:
    ends = []
    for part in ("thigh", "upper_arm"):
        roles = [f"{side}_{part}" for side in SIDES]
        bones = [target.index(role) for role in roles]
        if min(bones) < 0:
            return float("nan")
        ends.append((target.heads[bones].mean(0), actor.rest[[JOINT_OF[role] for role in roles]].mean(0)))
    own, theirs = (float(np.linalg.norm(ends[1][k] - ends[0][k])) for k in range(2))
    return own / theirs
