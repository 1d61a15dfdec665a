"""Which of a recording's labels name markers that a layout knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from solver_backend.body.marker_layouts import load_layouts

LEAST_MARKERS = 8
"""Fewer do not fix a person: a body is placed by six, and some are hidden at times."""


@dataclass(frozen=True)
class MarkerNames:
    """What the labels of a recording mean."""

    known: dict[str, str]
    """Place on the body by the label that names it."""
    unknown: tuple[str, ...]
    """Labels that no layout knows."""
    virtual: tuple[str, ...]
    """Labels of computed points: joint centres, axes of segments."""
    doubled: tuple[str, ...]
    """Labels of places that an earlier label has taken."""


def name_markers(labels: Sequence[str]) -> MarkerNames:
    """Return what labels mean; of two that name one place the first counts."""
    layouts = load_layouts()
    places = {label: layouts.place_of(label) for label in labels}
    first = {place: label for label, place in reversed(places.items()) if place is not None}
    virtual = tuple(label for label in places if layouts.is_virtual(label))
    return MarkerNames(
        known={label: place for label, place in places.items() if place is not None and first[place] == label},
        unknown=tuple(label for label, place in places.items() if place is None and label not in virtual),
        virtual=virtual,
        doubled=tuple(label for label, place in places.items() if place is not None and first[place] != label),
    )
