"""Labels that may name several places: the other labels of the recording may leave one of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from solver_backend.body.marker_layouts import LayoutFile

_ARM, _LEG = ("elbow", "wrist", "hand"), ("knee", "ankle", "foot")
_LIMBS = dict.fromkeys(_ARM, "arm") | dict.fromkeys(_LEG, "leg")
_WAIST = ("FWT", "MWT")
"""Places of the pelvis whose skin moves with the hips."""


def chosen_places(ambiguous: Mapping[str, tuple[str, ...]], known: Collection[str], file: LayoutFile) -> dict[str, str]:
    """Return the place of each label of which one alone is left: no other label names it, and others are on its limb.

    ``LateralEpicondyleL`` is the elbow's where arms have markers and legs have none, or where the knee has its own.

    Args:
        ambiguous: places by label.
        known: places that other labels name.
        file: of the layouts.
    """
    limbs = {limb for place in known if (limb := limb_of(place, file))}
    found: dict[str, str] = {}
    for label, places in ambiguous.items():
        free = [place for place in places if place not in known]
        left = [place for place in free if limb_of(place, file) in limbs] if len(free) > 1 else free
        if len(left) == 1:
            found[label] = left[0]
    return found


def of_one_limb(places: Collection[str], file: LayoutFile) -> bool:
    """Return whether places are all of one arm with its shoulder, or of one leg."""
    rules = [file.sided.get(place[1:]) for place in places]
    joints = {
        "" if rule is None or place[1:] in _WAIST else str(rule["joint"])
        for place, rule in zip(places, rules, strict=True)
    }
    one_side = len({place[:1] for place in places}) == 1
    return one_side and any(joints and joints <= limb for limb in ({*_ARM, "shoulder"}, {*_LEG, "hip"}))


def limb_of(place: str, file: LayoutFile) -> str:
    """Return arm or leg of a sided place of the layouts below the shoulder or hip, empty elsewhere."""
    rule = file.sided.get(place[1:]) if place[:1] in ("L", "R") else None
    return "" if rule is None else _LIMBS.get(rule["joint"], "")
