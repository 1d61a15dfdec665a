"""Read marker labels: subjects, unnamed points and duplicates."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import count

from solver_backend.body.joint_names import is_joint_centre
from solver_backend.body.marker_names import LEAST_MARKERS, is_unnamed, name_markers

# Names of Plug-in Gait outputs: LHipAngles, RGroundReactionForce, LKneeMoment, RAnklePower.
_MODEL_OUTPUT = re.compile(r".+[a-z](Angles?|Forces?|Moments?|Powers?)")


def prefix_of(label: str) -> str:
    """Return the subject in a label such as 'Subject:LASI', or an empty text."""
    prefix, found, _ = label.rpartition(":")
    return prefix.strip() if found else ""


def subjects_of(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the subjects in the labels of named markers, in the order of the labels."""
    return tuple(dict.fromkeys(prefix_of(label) for label in labels if prefix_of(label) and not is_unnamed(label)))


def is_model_output(label: str) -> bool:
    """Return whether a point name, such as 'LHipAngles', denotes a model output."""
    return _MODEL_OUTPUT.fullmatch(label.rpartition(":")[2].strip()) is not None


def unique_labels(labels: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Make labels unique. Return the labels that occur more than once too.

    An empty label becomes '*' with its position, counted from 1. The second 'LASI' becomes 'LASI (2)'.
    """
    taken, unique = set(labels), dict[str, None]()
    copies: dict[str, Iterator[int]] = defaultdict(lambda: count(2))
    for number, label in enumerate(labels, 1):
        name = base = label or f"*{number}"
        while name in unique or (name != label and name in taken):
            name = f"{base} ({next(copies[base])})"
        unique[name] = None
    return tuple(unique), tuple(label for label, times in Counter(filter(None, labels)).items() if times > 1)


UNPREFIXED = "Unprefixed"  # Subject of labels without a prefix if other labels have one.
_FIRST = re.compile(r"(?P<subject>[^:]+?)[ ._-](?P<name>.+)")
_LAST = re.compile(r"(?P<name>.+)[ ._-](?P<subject>[^:]+?)")
_COLON_LAST = re.compile(r"(?P<name>[^:]+):(?P<subject>[^:]+)")
_COLON = re.compile(r"(?P<subject>.+):(?P<name>[^:]+)")


def by_subject(labels: Sequence[str]) -> tuple[str, ...]:
    """Write the labels of several people with the same markers as ``Subject:LASI``.

    Recognised forms are ``Anna_LASI`` and ``Ben_LASI``, ``LASI_1`` and ``LASI_2``, ``LASI:Anna`` and ``LASI:Ben``, and
    ``Anna:LASI`` with ``LASI``. Other labels do not change.
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
    """Return ``Subject:name`` of each label if the pattern separates several people with the same body markers.

    If it does not, return an empty dictionary. The people must have at least half as many landmarks in common as the
    person with the fewest has. Parts of one person under several names have no landmark in common.
    """
    groups: dict[str, dict[str, str]] = {}
    for label in labels:
        if found := pattern.fullmatch(label):
            groups.setdefault(found["subject"].strip(), {})[label] = found["name"].strip()
    large = {subject: list(names.values()) for subject, names in groups.items() if len(names) >= LEAST_MARKERS}
    people = {subject: places for subject in large if len(places := _places(large[subject])) >= LEAST_MARKERS}
    if len(people) < 2:
        return {}
    shared, counts = frozenset[str].intersection(*people.values()), [len(worn) for worn in people.values()]
    # Labels that mostly name landmarks as they are need no pattern.
    if 2 * len(shared) < min(counts) or sum(counts) < 2 * len(_places(list(labels))):
        return {}
    return {label: f"{subject}:{name}" for subject in people for label, name in groups[subject].items()}


def _places(names: list[str]) -> frozenset[str]:
    return frozenset(place for place in name_markers(names).known.values() if not is_joint_centre(place))
