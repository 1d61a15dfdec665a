"""Four markers around a head under each other's names: over a take a head faces where the shoulders do."""

from __future__ import annotations

import numpy as np

from solver_backend.labelling.outputs import MARKERS
from solver_backend.labelling.tracklets import Tracklets

AROUND = tuple(MARKERS.index(name) for name in ("LFHD", "RFHD", "RBHD", "LBHD"))
"""The head's markers, one beside the other."""
_PAIRS = tuple((MARKERS.index("L" + name), MARKERS.index("R" + name)) for name in ("SHO", "FWT", "BWT"))
SIDEWAYS = np.radians(70.0)
"""Mean turn of a head against shoulders and waist from which on the names are wrong. In 158 takes of UI-PRMD it is 43
degrees at most, in 28 other files 56; names a quarter turn off add 90."""
LEAST_FRAMES = 10
"""Frames that have to show the four."""


def with_head_forward(
    positions: np.ndarray, tracklets: Tracklets, labels: np.ndarray, bound: dict[int, int]
) -> np.ndarray:
    """Return the label of each chain, the head's four turned about it by quarters where it faces sideways.

    A head that is wider than long looks as well turned by a quarter by its distances.

    Args:
        positions: (F, N, 3) metres, NaN where missing.
        tracklets: of the points.
        labels: (C,) label of each chain, negative where it has none.
        bound: labels assigned by the user, by chain; a head with one of these is left.
    """
    if any(label in AROUND for label in bound.values()):
        return labels
    tracks = {m: _track(positions, tracklets, labels, m) for m in (*AROUND, *(m for pair in _PAIRS for m in pair))}
    left = [tracks[a] - tracks[b] for a, b in _PAIRS if (np.isfinite(tracks[a] - tracks[b])).any()]
    head = np.stack([tracks[m] for m in AROUND], axis=1)
    if not left:
        return labels
    turns = [_turn(np.roll(head, quarter, axis=1), left) for quarter in range(4)]
    best = int(np.argmin(np.abs(turns)))
    if not abs(turns[0]) > SIDEWAYS:
        return labels
    found = labels.copy()
    for place, marker in enumerate(AROUND):
        found[labels == marker] = AROUND[(place + best) % 4]
    return found


def _track(positions: np.ndarray, tracklets: Tracklets, labels: np.ndarray, marker: int) -> np.ndarray:
    """Return (F, 3) the points of a marker."""
    number = tracklets.number
    mine = (number >= 0) & (labels[tracklets.chain[number]] == marker)
    track = np.full((len(positions), 3), np.nan)
    frames, columns = np.nonzero(mine)
    track[frames] = positions[frames, columns]
    return track


def _turn(head: np.ndarray, left: list[np.ndarray]) -> float:
    """Return the mean angle from the head's left to the body's in the head's plane, rad; 0 where nothing shows it.

    Args:
        head: (F, 4, 3) its markers in the order of ``AROUND``.
        left: vectors (F, 3) from the body's right to its left.
    """
    lf, rf, rb, lb = np.moveaxis(head, 1, 0)
    own_left, front = _unit(lf + lb - rf - rb), _unit(lf + rf - lb - rb)
    body = _unit(np.nansum([_unit(side) for side in left], axis=0))
    along, across = (own_left * body).sum(-1), (front * body).sum(-1)
    there = np.isfinite(along) & np.isfinite(across)
    if there.sum() < LEAST_FRAMES:
        return 0.0
    return float(np.arctan2(across[there].mean(), along[there].mean()))


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)
