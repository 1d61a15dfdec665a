"""Hands that touch the body by palms or fingertips: kept on its skin on a figure of other proportions."""

from __future__ import annotations

import numpy as np

from ..._exchange.rigs.roles import JOINT_OF
from .figures import Actor, Target
from .hand_places import HandPlace, fade, hand_places
from .solids import BASE, CHEST, PARTS, TOP, Solid, solids_of
from .trunk import trunk_ends

_TOUCH, _APART = (0.2, 0.35), (0.4, 0.65)
"""Distances from the skin by the length of the palm up to which a hand touches, and from which it does not: of a
fingertip, which has a tenth of it as its own radius, and of the palm's middle, whose own skin is a fifth below it."""
_LIKELY = (0.4, 2.5)
"""Radii of the target by the actor's, at its size, beyond which its skin is not taken for a body's."""
_CHEST_JOINT, _NECK, _HIPS = 9, 12, (1, 2)
"""SMPL's."""


def keep_hands_on_body(
    actor: Actor,
    target: Target,
    A: np.ndarray,
    turns: np.ndarray,
    places: np.ndarray,
    goals: dict[str, np.ndarray],
    scale: float,
) -> dict[str, np.ndarray]:
    """Return where wrists belong once palms and fingertips that touch the body are as far from its skin as the actor's.

    A place has a share t of the rod of each part, an angle φ about it, and a distance from the skin; on the target it
    has the same t and φ, and the distance by the hands' size: ``r'(t, φ) + (s'/s) (d - r(t, φ))``. Between touching
    and not, the shift there fades. Where several parts are touched, or several places of a
    hand touch, the ways are weighted alike.

    Args:
        actor: the motion.
        target: the rig.
        A: (N, 3, 3) its map pose.
        turns: (N, F, 3, 3) rotations of its controls, limbs bent to their goals.
        places: (N, F, 3) their heads.
        goals: (F, 3) by role, hands among them.
        scale: length of the target's legs by the actor's.
    """
    own, theirs = _solids_of_actor(actor), _solids_of_target(target, A)
    both = [name for name in PARTS if name in own and name in theirs and _is_likely(own[name], theirs[name], scale)]
    ways, totals = dict[str, np.ndarray](), dict[str, np.ndarray]()
    for place in hand_places(actor, target, turns, goals) if both else ():
        arm = tuple(f"{place.side}_{part}" for part in ("upper_arm", "forearm"))
        way = ways.setdefault(place.role, np.zeros_like(place.own))
        total = totals.setdefault(place.role, np.zeros(len(place.own)))
        for name in both:
            if name in arm:
                continue
            share, goal = _kept_on(actor, place, name, own[name], theirs[name])
            c = _control_of(target, name)
            way += share[:, None] * (places[c] + (turns[c] @ A[c].T @ goal[..., None])[..., 0] - place.own)
            total += share
    return goals | {role: goals[role] + way / np.maximum(totals[role], 1.0)[:, None] for role, way in ways.items()}


def _kept_on(
    actor: Actor, place: HandPlace, name: str, own: Solid, theirs: Solid
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return how far a place of a hand touches a part (F,), and where it belongs in its axes on the target (F, 3)."""
    joint, (low, high) = _joint_of(name), PARTS[name].span
    inner = np.swapaxes(actor.turns[:, joint], -1, -2) @ (place.place - actor.joints[:, joint])[..., None]
    share, angle, distance = own.coordinates(inner[..., 0])
    off = distance - own.radius(share, angle)
    beyond = own.length * np.maximum(np.maximum(low - share, share - high), 0.0)
    touching = 1.0 - fade(
        np.hypot(np.maximum(off, 0.0), beyond) / place.size, _TOUCH[place.is_palm], _APART[place.is_palm]
    )
    kept = theirs.radius(share, angle) + place.own_size / place.size * off
    return touching, theirs.place(share, angle, np.maximum(kept, 0.0))


def _is_likely(own: Solid, theirs: Solid, scale: float) -> bool:
    ratio = float(np.median(theirs.radii) / max(np.median(own.radii) * scale, 1e-9))
    return _LIKELY[0] < ratio < _LIKELY[1]


def _joint_of(name: str) -> int:
    turned_by = PARTS[name].turned_by
    return _CHEST_JOINT if turned_by == CHEST else JOINT_OF[turned_by]


def _control_of(target: Target, name: str) -> int:
    turned_by = PARTS[name].turned_by
    return trunk_ends(target)[2] if turned_by == CHEST else target.index(turned_by)


def _solids_of_actor(actor: Actor) -> dict[str, Solid]:
    heads = {role: actor.rest[joint] for role, joint in JOINT_OF.items()}
    trunk = {BASE: actor.rest[list(_HIPS)].mean(0), TOP: actor.rest[_NECK], CHEST: actor.rest[_CHEST_JOINT]}
    return solids_of(heads | trunk, {}, actor.skin)


def _solids_of_target(target: Target, A: np.ndarray) -> dict[str, Solid]:
    base, top, chest = trunk_ends(target)
    heads = dict(zip(target.roles, target.heads, strict=True))
    turns = dict(zip(target.roles, A, strict=True))
    trunk = {BASE: base, TOP: top, CHEST: target.heads[chest]}
    return solids_of(heads | trunk, turns | {CHEST: A[chest]}, target.skin)
