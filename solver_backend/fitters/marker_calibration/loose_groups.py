"""Which markers are a prop's: groups that keep their distances, and that no bone of the person carries."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import is_unnamed
from solver_backend.fitters.marker_calibration.attach_unknown import REACH_M, RESIDUAL_M, bone_offsets
from solver_backend.fitters.marker_calibration.rigid_groups import rigid_groups
from solver_backend.types import MarkerCloud

SEPARATOR = ":"
"""Between a subject's prefix and a label."""
_OTHER = {"l": "R", "r": "L", "left": "right", "right": "left"}
_SIDE = tuple(re.compile(text, re.IGNORECASE) for text in (r"left|right", r"^[lr]", r"[lr](?=[\W\d_]*$)"))
_NO_PARTS = {"LAT", "MED", "FRONT", "BACK", "TOP", "UPPER", "BIG", "GREATER", "FIRST", "SECOND", "THIRD", "FIFTH"}
"""Words of labels that name no part of a body."""
_FIRST_WORD = re.compile(r"[^\W\d_]([A-Z]+(?![a-z])|[^\W\dA-Z_]*)")
LEAST_NAME = 3
"""Letters that markers' labels have in common from which on these are a prop's name."""


@dataclass(frozen=True)
class LooseGroup:
    """Markers of one prop."""

    name: str
    """The prefix or the beginning that their labels share; else a number."""
    columns: tuple[int, ...]
    """Their columns in the cloud."""


@dataclass(frozen=True)
class BonePoses:
    """Where the bones of the person are in F frames."""

    joints: np.ndarray
    """(F, 24, 3) metres."""
    rotations: np.ndarray
    """(F, 24, 3, 3) global rotations."""

    def carry(self, points: np.ndarray) -> bool:
        """Return whether one bone carries (F, M, 3) markers: most of them are near it and stay where they are on it."""
        offsets = [bone_offsets(points[:, m], self.joints, self.rotations) for m in range(points.shape[1])]
        spread, reach = (np.median([item[k] for item in offsets], axis=0) for k in (1, 2))
        return bool(((spread < RESIDUAL_M) & (reach < REACH_M)).any())


def loose_groups(cloud: MarkerCloud, bones: BonePoses | None = None) -> list[LooseGroup]:
    """Return the groups of markers that move as rigid bodies, markers of one prefix with one another.

    Args:
        cloud: labelled markers that are no known places of a body.
        bones: of the person in these frames; groups that one of them carries are left out.
    """
    labels = cloud.labels or ()
    prefixes = [label.rpartition(SEPARATOR)[0].strip() for label in labels]
    found = list[LooseGroup]()
    for prefix in dict.fromkeys(prefixes):
        own = [i for i, name in enumerate(prefixes) if name == prefix]
        for group in rigid_groups(cloud.positions[:, own]):
            columns = tuple(own[m] for m in group)
            names = {labels[i] for i in columns}
            worn = bones is not None and (
                _is_one_of_a_pair(names, labels) or _names_a_part(names) or bones.carry(cloud.positions[:, columns])
            )
            if not worn:
                found.append(LooseGroup(_name([labels[i] for i in columns], len(found) + 1), columns))
    names = [group.name for group in found]
    return [
        group if names.index(group.name) == n else LooseGroup(f"{group.name} {n + 1}", group.columns)
        for n, group in enumerate(found)
    ]


def _name(labels: list[str], number: int) -> str:
    prefix = labels[0].rpartition(SEPARATOR)[0].strip()
    if any(is_unnamed(label) for label in labels):
        return f"Prop {number}"
    shared = _beginning([label.rpartition(SEPARATOR)[2].strip() for label in labels]).rstrip(" _-.0123456789")
    return prefix or (shared if len(shared) >= LEAST_NAME else f"Prop {number}")


def _is_one_of_a_pair(group: set[str], labels: Sequence[str]) -> bool:
    """Return whether most markers of a group have a left or right counterpart outside it: a shoe's, a limb's."""
    outside = {label.casefold() for label in labels if label not in group}
    paired = [label for label in group if mirrored_labels(label) & outside]
    return 2 * len(paired) > len(group)


def _names_a_part(group: set[str]) -> bool:
    """Return whether the labels of most markers begin with a part of the body: ``Head.L``, not ``RacketHead``."""
    words = load_layouts().words
    first = [(_FIRST_WORD.match(label.rpartition(SEPARATOR)[2].strip()) or [""])[0] for label in group]
    return 2 * sum(bool(set(words.of(word)[1]) - _NO_PARTS) for word in first) > len(group)


def mirrored_labels(label: str) -> set[str]:
    """Return what the same place on the other side may be called: the first or last L, R, left or right turned."""
    prefix, colon, name = label.rpartition(SEPARATOR)
    turned = {pattern.sub(lambda found: _OTHER[found[0].lower()], name, count=1) for pattern in _SIDE}
    return {(prefix + colon + text).casefold() for text in turned} - {label.casefold()}


def _beginning(texts: list[str]) -> str:
    """Return what texts begin with alike."""
    count = next(
        (n for n, letters in enumerate(zip(*texts, strict=False)) if len(set(letters)) > 1), min(map(len, texts))
    )
    return texts[0][:count]
