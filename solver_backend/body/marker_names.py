"""Which of a recording's labels name markers that a layout knows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from solver_backend.body.marker_layouts import load_layouts

# Vicon writes *0, *1, ...; Motive 'Unlabeled 1189'; Cortex U_1; Qualisys unnames; others number their points.
_UNNAMED = re.compile(r"(\*\d*|unlabell?ed[ _-]?\d*|u_?\d+|uname\*?\d*|unnamed[ _-]?\d*|new ?\d{4})", re.IGNORECASE)
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
    """Labels of computed points (joint centres, axes of segments), and those left out by hand."""
    doubled: tuple[str, ...]
    """Labels of places that an earlier label has taken."""


def is_unnamed(label: str) -> bool:
    """Return whether a program numbered the point because nobody named it."""
    name = label.rpartition(":")[2].strip()
    return not name or _UNNAMED.fullmatch(name) is not None


def name_markers(labels: Sequence[str], own: Mapping[str, str] = MappingProxyType({})) -> MarkerNames:
    """Return what labels mean; of two that name one place the first counts.

    Args:
        labels: of the recording.
        own: place by label, told by hand, which goes first: a name of the layouts, ``@`` and a bone's joint (which many
            may share), or empty where a label is to be left out.
    """
    layouts = load_layouts()
    places = {label: own[label] or None if label in own else layouts.place_of(label) for label in labels}
    first = {place: label for label, place in reversed(places.items()) if place is not None and place[0] != "@"}
    virtual = tuple(
        label for label in places if own.get(label) == "" or (label not in own and layouts.is_virtual(label))
    )
    return MarkerNames(
        known={
            label: place for label, place in places.items() if place is not None and first.get(place, label) == label
        },
        unknown=tuple(label for label, place in places.items() if place is None and label not in virtual),
        virtual=virtual,
        doubled=tuple(
            label for label, place in places.items() if place is not None and first.get(place, label) != label
        ),
    )
