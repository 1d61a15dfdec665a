"""Several people in one file whose labels are not ``Subject:LASI``: kept apart by what stands before or after."""

from __future__ import annotations

import re
from collections.abc import Sequence

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_names import LEAST_MARKERS, is_unnamed, name_markers

UNPREFIXED = "Unprefixed"
"""Subject of the labels without a prefix, where they are another person's."""
_FIRST = re.compile(r"(?P<subject>[^:]+?)[ ._-](?P<name>.+)")
_LAST = re.compile(r"(?P<name>.+)[ ._-](?P<subject>[^:]+?)")
_COLON_LAST = re.compile(r"(?P<name>[^:]+):(?P<subject>[^:]+)")
_COLON = re.compile(r"(?P<subject>.+):(?P<name>[^:]+)")


def by_subject(labels: Sequence[str]) -> tuple[str, ...]:
    """Return labels as ``Subject:LASI`` where two people or more wear the same places, else as they are.

    Read are ``Anna_LASI`` and ``Ben_LASI``, ``LASI_1`` and ``LASI_2``, ``LASI:Anna`` and ``LASI:Ben``, and
    ``Anna:LASI`` beside ``LASI``.
    """
    named = [label for label in labels if label and not is_unnamed(label)]
    colons = [label for label in named if ":" in label]
    if not colons:
        split = next((renamed for pattern in (_FIRST, _LAST) if (renamed := _people(named, pattern))), None)
    elif _people(colons, _COLON):
        split = None
    elif not (split := _people(colons, _COLON_LAST)):
        bare = {label: f"{UNPREFIXED}:{label}" for label in named if ":" not in label}
        split = bare if _people([*colons, *bare.values()], _COLON) else None
    return tuple((split or {}).get(label, label) for label in labels)


def _people(labels: Sequence[str], pattern: re.Pattern[str]) -> dict[str, str]:
    """Return ``Subject:name`` by label of the subjects that wear the places of a body, empty unless there are several.

    Half of the places of the one with the fewest are the others' too: parts of one person under several names share
    none.
    """
    groups: dict[str, dict[str, str]] = {}
    for label in labels:
        if found := pattern.fullmatch(label):
            groups.setdefault(found["subject"].strip(), {})[label] = found["name"].strip()
    large = {subject: list(names.values()) for subject, names in groups.items() if len(names) >= LEAST_MARKERS}
    worn = {subject: _places(names) for subject, names in large.items()} if len(large) > 1 else {}
    people = [subject for subject, places in worn.items() if len(places) >= LEAST_MARKERS]
    shared = frozenset[str].intersection(*(worn[subject] for subject in people)) if len(people) > 1 else frozenset()
    apart = sum(len(worn[subject]) for subject in people)
    if len(people) < 2 or 2 * len(shared) < min(len(worn[subject]) for subject in people):
        return {}
    if apart < 2 * len(_places(list(labels))):  # most are known as they are
        return {}
    return {label: f"{subject}:{name}" for subject in people for label, name in groups[subject].items()}


def _places(names: list[str]) -> frozenset[str]:
    """Return the places of markers on the skin: what is named like a skeleton may be axes of its segments."""
    return frozenset(place for place in name_markers(names).known.values() if not is_joint_centre(place))
