"""Whether a map can be that of a person: names may be right by chance, lengths and sides are not."""

from __future__ import annotations

import numpy as np

from .roles import LIMBS, SIDES
from .skeleton import Skeleton

_RATIO = 2.5
"""Factor between the two bones of a limb that no person and hardly a cartoon has."""
_ALIKE = 0.3
"""Relative difference between left and right limbs."""


def is_plausible(bones: dict[str, str], skeleton: Skeleton) -> bool:
    """Return whether the limbs of a map have lengths, likeness of sides and directions that a person's can have."""
    index = {name: i for i, name in enumerate(skeleton.names)}
    places = {role: skeleton.heads[index[bone]] for role, bone in bones.items() if bone in index}
    lengths: dict[str, float] = {}
    for limb, roles in LIMBS.items():
        if not set(roles) <= places.keys():
            continue
        upper, lower = (float(np.linalg.norm(places[b] - places[a])) for a, b in (roles[:2], roles[1:]))
        if upper > _RATIO * lower or lower > _RATIO * upper:
            return False
        lengths[limb] = upper + lower
    for kind in ("arm", "leg"):
        both = [lengths[f"{side}_{kind}"] for side in SIDES if f"{side}_{kind}" in lengths]
        if both and max(both) - min(both) > _ALIKE * max(both):
            return False
    return _legs_go_down(places)


def _legs_go_down(places: dict[str, np.ndarray]) -> bool:
    """Return whether the legs do not go the way of the trunk."""
    parts = ("thigh", "foot", "upper_arm")
    if not all(f"{side}_{part}" in places for side in SIDES for part in parts):
        return True
    hips, feet, shoulders = (np.mean([places[f"{side}_{part}"] for side in SIDES], axis=0) for part in parts)
    leg, trunk = feet - hips, shoulders - hips
    return bool(leg @ trunk <= 0.5 * np.linalg.norm(leg) * np.linalg.norm(trunk))
