"""Labels that may name several places: the other labels of the recording may leave one of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from solver_backend.body.marker_layouts import LayoutFile

_LIMBS = {"elbow": "arm", "wrist": "arm", "hand": "arm", "knee": "leg", "ankle": "leg", "foot": "leg"}


def chosen_places(ambiguous: Mapping[str, tuple[str, ...]], known: Collection[str], file: LayoutFile) -> dict[str, str]:
    """Return the place of each label of which one alone is left: no other label names it, and others are on its limb.

    ``LateralEpicondyleL`` is the elbow's where arms have markers and legs have none, or where the knee has its own.

    Args:
        ambiguous: places by label.
        known: places that other labels name.
        file: of the layouts.
    """
    limbs = {limb for place in known if (limb := _limb(place, file))}
    found: dict[str, str] = {}
    for label, places in ambiguous.items():
        free = [place for place in places if place not in known]
        left = [place for place in free if _limb(place, file) in limbs] if len(free) > 1 else free
        if len(left) == 1:
            found[label] = left[0]
    return found


def _limb(place: str, file: LayoutFile) -> str:
    """Return arm or leg of a sided place of the layouts below the shoulder or hip, empty elsewhere."""
    rule = file.sided.get(place[1:]) if place[:1] in ("L", "R") else None
    return "" if rule is None else _LIMBS.get(rule["joint"], "")
