"""Labels of markers: subjects, points that nobody named, and labels that must be made unique."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import count

from solver_backend.body.marker_names import is_unnamed

# Plug-in Gait: LHipAngles, RGroundReactionForce, LKneeMoment, RAnklePower.
_MODEL_OUTPUT = re.compile(r".+[a-z](Angles?|Forces?|Moments?|Powers?)")


def prefix_of(label: str) -> str:
    """Return the subject in 'Subject:LASI', empty where there is none."""
    prefix, found, _ = label.rpartition(":")
    return prefix.strip() if found else ""


def subjects_of(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the subjects that labels name, in their order, leaving unnamed points out."""
    return tuple(dict.fromkeys(prefix_of(label) for label in labels if prefix_of(label) and not is_unnamed(label)))


def is_model_output(label: str) -> bool:
    """Return whether a point is no position but what a model computed, by its name: 'LHipAngles'."""
    return _MODEL_OUTPUT.fullmatch(label.rpartition(":")[2].strip()) is not None


def unique_labels(labels: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return labels that are neither empty nor there twice, and those that were there twice.

    An empty label becomes '*' and its number from 1; the second 'LASI' becomes 'LASI (2)'.
    """
    counts = Counter(label for label in labels if label)
    taken: set[str] = set(counts)
    numbers: dict[str, int] = {}
    unique: list[str] = []
    for number, label in enumerate(labels, 1):
        name = base = label or f"*{number}"
        if label in numbers or (not label and base in taken):
            next_number = next(k for k in count(numbers.get(label, 2)) if f"{base} ({k})" not in taken)
            name = f"{base} ({next_number})"
            if label:
                numbers[label] = next_number
        elif label:
            numbers[label] = 2
        taken.add(name)
        unique.append(name)
    return tuple(unique), tuple(label for label, times in counts.items() if times > 1)
