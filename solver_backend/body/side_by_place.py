"""A limb whose labels name no side, as of a shoulder laboratory: its side is where it is beside the trunk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from solver_backend.body.label_choice import limb_of
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.geometry.quantiles import quantile
from solver_backend.types import MarkerCloud

LEAST_LABELS = 2
"""Labels without a side that name a limb, at least."""
BESIDE_M = 0.05
"""Metres beside the middle of the trunk that every marker of the limb has in most frames; an acromion has 170."""
_TWINS = {("l", "m"): ("lat", "med"), ("r", "u"): ("radius", "ulna")}
"""Endings that mean these words where both are there: ``EPICl`` and ``EPICm``, ``STYLr`` and ``STYLu``."""


def places_by_side(cloud: MarkerCloud, own: Mapping[str, str] = MappingProxyType({})) -> dict[str, str]:
    """Return the place of labels that name a limb without its side, by the side of the trunk it is on.

    The trunk's own sides are those of pairs of labels that state them, as both ASIS. Nothing is returned where no pair
    is there, labels of a limb state a side, or markers of the limb are on both sides of the trunk's middle.

    Args:
        cloud: with labels.
        own: the user's places by label, which go first.
    """
    labels = [label for label in cloud.labels or () if not is_unnamed(label)]
    names = name_markers(labels, own)
    bare = {label: names.affixes.bare(label) for label in (*names.unknown, *names.doubled)}
    parts = _parts(bare)
    pairs = [(a, b) for a, place in names.known.items() for b, other in names.known.items()
             if place[0] == "L" and other == "R" + place[1:]]  # fmt: skip
    sided = {limb_of(place, load_layouts()) for place in names.known.values()}
    parts = {label: part for label, part in parts.items() if limb_of("L" + part, load_layouts()) not in sided - {""}}
    if len(parts) < LEAST_LABELS or not pairs:
        return {}
    off = _to_the_left(cloud, pairs, list(parts))
    if not np.isfinite(off).all() or (abs(off) < BESIDE_M).any() or len(set(np.sign(off))) > 1:
        return {}
    side = "L" if off[0] > 0 else "R"
    taken = set(names.known.values())
    return {label: side + part for label, part in parts.items() if side + part not in taken}


def _parts(bare: Mapping[str, str]) -> dict[str, str]:
    """Return the place without its side by label; of several places the one on a limb that other labels name."""
    words, there = load_layouts().words, set(bare.values())
    several: dict[str, tuple[str, ...]] = {}
    for label, name in bare.items():
        found = words.without_side(name)
        for endings, meant in _TWINS.items():
            if name[-1:] in endings and {name[:-1] + ending for ending in endings} <= there:
                found = words.without_side(f"{name[:-1]} {meant[endings.index(name[-1])]}")
        if found:
            several[label] = found
    limbs = {limb_of("L" + parts[0], load_layouts()) for parts in several.values() if len(parts) == 1} - {""}
    chosen: dict[str, str] = {}
    for label, parts in several.items():
        left = parts if len(parts) == 1 else [part for part in parts if limb_of("L" + part, load_layouts()) in limbs]
        if len(left) == 1 and left[0] not in chosen.values():
            chosen[label] = left[0]
    return chosen


def _to_the_left(cloud: MarkerCloud, pairs: Sequence[tuple[str, str]], labels: Sequence[str]) -> np.ndarray:
    """Return how far markers are left of the middle of pairs of left and right markers, metres, medians over frames."""
    column = {label: i for i, label in enumerate(cloud.labels or ())}
    left, right = (cloud.positions[:, [column[pair[side]] for pair in pairs]].mean(axis=1) for side in (0, 1))
    across = (left - right) / np.maximum(np.linalg.norm(left - right, axis=-1, keepdims=True), 1e-9)
    away = cloud.positions[:, [column[label] for label in labels]] - 0.5 * (left + right)[:, None]
    return quantile(np.einsum("fli,fi->fl", away, across), 0.5, axis=0)
