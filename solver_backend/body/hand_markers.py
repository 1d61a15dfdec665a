"""Recognise hand markers by their labels, and place them on a hand skeleton."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.body.hand_skeleton import HandSites, HandSkeleton
from solver_backend.exchange.joint_sets import FINGERS

THICKNESS_M = 0.010  # Distance in metres from the centre of a finger joint to the centre of a marker on its back.
PALM_THICKNESS_M = 0.016  # The same distance for the palm.
_ROOT = 0.3  # Position of the metacarpal bases, as a fraction of the distance from wrist to knuckle.


@dataclass(frozen=True)
class HandMarkers:
    """Markers on one hand, with their positions on a hand of average shape."""

    labels: tuple[str, ...]
    sites: HandSites  # Their positions on a hand of average shape.


def _places() -> dict[str, tuple[int, int, float]]:
    """Return the finger, the segment and the position along the segment for every label."""
    found = {"FT1": (0, 3, 0.9), "IP": (0, 2, 1.0), "MP1": (0, 1, 1.0), "CMC1": (0, 0, 1.0)}
    for number in range(1, len(FINGERS)):
        own = {"FT": (number, 3, 0.8), "DP": (number, 2, 1.0), "PP": (number, 1, 1.0), "MP": (number, 0, 1.0)}
        found |= {f"{label}{number + 1}": place for label, place in own.items()}
    return found | {"CMC2": (1, 0, _ROOT), "CMC5": (4, 0, _ROOT)}


PLACES = _places()  # By label.
_LABEL = re.compile(rf"(left|right|l|r)[ _\-.:]?({'|'.join(PLACES)})", re.IGNORECASE)  # A side and a location.


def hand_place(label: str) -> tuple[int, str] | None:
    """Return the side (0 left, 1 right) and place of a hand marker such as ``L_FT2``, or None for other labels."""
    match = _LABEL.fullmatch(label.rsplit(":", 1)[-1].strip())
    return None if match is None else (("l", "r").index(match[1][0].lower()), match[2].upper())


LEAST = 3  # Smallest number of markers on a hand. A single label such as LMP1 may belong to a foot.


def hand_columns(labels: Sequence[str]) -> dict[int, dict[str, int]]:
    """Map the side and place of each hand marker to its column. Sides with under ``LEAST`` markers are omitted."""
    found: dict[int, dict[str, int]] = {0: {}, 1: {}}
    for column, label in enumerate(labels):
        if (place := hand_place(label)) is not None:
            found[place[0]].setdefault(place[1], column)
    return {side: columns for side, columns in found.items() if len(columns) >= LEAST}


def hand_labels(labels: Sequence[str]) -> dict[str, str]:
    """Map the label of each hand marker to its place, such as ``L_FT2`` (see ``hand_columns``)."""
    found = hand_columns(labels)
    return {labels[c]: f"{'LR'[side]}_{place}" for side, columns in found.items() for place, c in columns.items()}


def hand_markers(skeleton: HandSkeleton, labels: tuple[str, ...]) -> HandMarkers:
    """Place hand markers on a hand skeleton, given labels without a side, such as ``FT2``. Other labels are skipped."""
    known = tuple(label for label in labels if label in PLACES)
    finger, segment, along = (np.array([PLACES[label][i] for label in known]) for i in range(3))
    finger, segment = finger.astype(int), segment.astype(int)
    offset = np.zeros((len(known), 3))
    palm = segment == 0
    bones = skeleton.bones[finger, np.maximum(segment - 1, 0)]
    offset[~palm] = (along[:, None] * bones + [0.0, THICKNESS_M, 0.0])[~palm]
    dorsal = skeleton.palm[2, :, 1]
    offset[palm] = (along[:, None] * skeleton.roots[finger] + PALM_THICKNESS_M * dorsal)[palm]
    return HandMarkers(known, HandSites(finger, segment, offset))
