"""Which of a recording's labels name markers that a layout knows."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType

from solver_backend.body.joint_names import joint_centre_places
from solver_backend.body.label_choice import chosen_places, of_one_limb
from solver_backend.body.label_context import context_of
from solver_backend.body.label_words import Affixes
from solver_backend.body.marker_layouts import load_layouts

# Vicon writes *0, *1, ...; Motive 'Unlabeled 1189', 'Unlabeled:2012' or 'Unlabeled_7'; Cortex U_1; Qualisys unnames;
# others number their points.
_WORDS = r"(unlabell?ed|unnamed|unidentified|unlabel|uname|unbenannt|sans ?nom)"
_UNNAMED = re.compile(
    rf"(\*\d*|#\d*|u_?\d+|new ?\d{{4}}|[*#]?{_WORDS}[\s:_*#.-]*((marker|point|trajectory)[\s:_*#.-]*)?\d*)( \(\d+\))?",
    re.IGNORECASE,
)
LEAST_MARKERS = 8
"""Fewer do not fix a person: a body is placed by six, and some are hidden at times."""
LEAST_LIMB_MARKERS = 6
"""The same where all are of one arm or leg: a leg of Plug-in Gait has six, an arm with its shoulder seven."""
LEAST_NETWORK_PLACES = 20
"""Places that the labelling network names at least where it knows a layout; fewer points are not worth a try."""


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
    """Labels of places that another label has taken."""
    ambiguous: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Places that a label may name, of labels that may name several; they are among the unknown."""
    affixes: Affixes = field(default_factory=Affixes)
    """What nearly all labels begin and end with, which is no part of their names."""


def least_markers(places: Collection[str]) -> int:
    """Return how many markers at these places are needed: fewer where they are all of one arm or one leg."""
    return LEAST_LIMB_MARKERS if of_one_limb(places, load_layouts()) else LEAST_MARKERS


def is_unnamed(label: str) -> bool:
    """Return whether a program numbered the point because nobody named it."""
    name = label.rpartition(":")[2].strip()
    return not name or any(_UNNAMED.fullmatch(text) is not None for text in (name, label.strip()))


def name_markers(labels: Sequence[str], own: Mapping[str, str] = MappingProxyType({})) -> MarkerNames:
    """Return what labels mean; of two that name one place a listed name goes first, then the first.

    Labels of a skeleton's joint centres are that together, see ``joint_centre_places``.

    Args:
        labels: of the recording.
        own: the user's place by label, which goes first: a name of the layouts, ``@`` and a bone's joint (which many
            may share), or empty where a label is to be left out.
    """
    found = _named(tuple(labels), tuple(own.items()))
    return replace(found, known=dict(found.known), ambiguous=dict(found.ambiguous))


@lru_cache(maxsize=64)
def _named(labels: tuple[str, ...], given: tuple[tuple[str, str], ...]) -> MarkerNames:
    """Return the same, which a solve asks for a dozen times; nobody may write into it."""
    own = {**joint_centre_places(labels), **dict(given)}
    file = load_layouts()
    context = context_of(labels, file, LEAST_MARKERS)
    meant = {label: () if label in own else context.places_of(label) for label in labels}
    several = {label: found for label, found in meant.items() if len(found) > 1}
    sure = {*own.values(), *(found[0] for found in meant.values() if len(found) == 1)}
    meant |= {label: (place,) for label, place in chosen_places(several, sure, file).items()}
    virtual = {
        label: own.get(label) == "" or (label not in own and context.is_virtual(label))
        for label in dict.fromkeys(labels)
    }
    places = {
        label: own[label] or None if label in own else found[0] if len(found) == 1 and not virtual[label] else None
        for label, found in meant.items()
    }
    # Surest first: what the user gave, names of the layouts, words.
    order = sorted(places, key=lambda label: 0 if label in own else 2 - context.is_exact(label))
    first = {place: label for label in reversed(order) if (place := places[label]) is not None and place[0] != "@"}
    known = {label: place for label, place in places.items() if place is not None and first.get(place, label) == label}
    return MarkerNames(
        known=known,
        unknown=tuple(label for label, place in places.items() if place is None and not virtual[label]),
        virtual=tuple(label for label in places if virtual[label]),
        doubled=tuple(label for label, place in places.items() if place is not None and label not in known),
        ambiguous={label: found for label, found in meant.items() if len(found) > 1},
        affixes=context.affixes,
    )
