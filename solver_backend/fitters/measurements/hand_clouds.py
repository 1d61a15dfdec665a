"""Markers of hands among a body's: known by their labels, solved beside the body."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solver_backend.body.hand_markers import PLACES
from solver_backend.exchange.hand_points import SIDES
from solver_backend.types import MarkerCloud

LEAST = 3
"""Markers of one hand that make it one: a single label such as LMP1 may be a foot's."""
_LABEL = re.compile(rf"(left|right|l|r)[ _\-.:]?({'|'.join(PLACES)})", re.IGNORECASE)


@dataclass(frozen=True)
class HandClouds:
    """Markers of one or both hands over F frames."""

    labels: Mapping[int, tuple[str, ...]]
    """Places of ``hand_markers`` by side, 0 left and 1 right."""
    positions: Mapping[int, np.ndarray]
    """(F, L, 3) metres by side, NaN where missing."""


def split_hands(cloud: MarkerCloud) -> tuple[MarkerCloud, HandClouds | None]:
    """Return a body's markers without those of hands, and these: ``L_FT2``, ``RPP3``, ``left_CMC2``.

    Args:
        cloud: everybody's markers; the same object comes back where it has none of hands.
    """
    found: dict[int, dict[str, int]] = {0: {}, 1: {}}
    for column, label in enumerate(cloud.labels or ()):
        if (match := _LABEL.fullmatch(label.rsplit(":", 1)[-1].strip())) is not None:
            side = [name[0] for name in SIDES].index(match[1][0].lower())
            found[side].setdefault(match[2].upper(), column)
    found = {side: columns for side, columns in found.items() if len(columns) >= LEAST}
    if not found:
        return cloud, None
    taken = {column for columns in found.values() for column in columns.values()}
    kept = [i for i in range(cloud.positions.shape[1]) if i not in taken]
    assert cloud.labels is not None
    body = cloud.columns(kept, tuple(cloud.labels[i] for i in kept))
    positions = {side: np.asarray(cloud.positions)[:, list(columns.values())] for side, columns in found.items()}
    return body, HandClouds({side: tuple(columns) for side, columns in found.items()}, positions)
