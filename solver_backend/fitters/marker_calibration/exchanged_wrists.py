"""The inner and the outer marker of a wrist under each other's names: a bent elbow shows the thumb's side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.geometry.quantiles import quantile
from solver_backend.labelling.names_over_takes import NameChange, NamesOverTakes, with_exchanged
from solver_backend.types import MarkerCloud

BENT = 0.35
"""Sine of the elbow's bend from which on it shows: straight arms look bent by 0.3 where the elbow's marker is."""
EXCHANGED = -0.3
"""Median cosine below which names are exchanged. In 351 arms of UI-PRMD's takes and of 40 other files it is 0.37 and
more in all but four, where it is -0.77 to -0.97 (docs/research-log/marker_names.md)."""
LEAST_FRAMES = 20
"""Frames in which the elbow has to be bent."""
_SHOULDERS, _ELBOWS = (("SHO",), ("FSH", "BSH")), ("ELB", "ELM")


def exchanged_wrists(points: np.ndarray, places: Sequence[str]) -> list[tuple[int, int]]:
    """Return the columns of WRA and WRB of each side on which they hold each other's names.

    Whichever way the hand turns, the thumb's side of the forearm is towards the upper arm, across the forearm: turned
    in and out by up to a right angle from there. With f from elbow to wrist and u from elbow to shoulder,
    ``(x_A - x_B) · (u - (u · f) f) > 0``.

    Args:
        points: (F, L, 3) metres, NaN where missing.
        places: of the L markers.
    """
    column = {place: i for i, place in enumerate(places)}
    pairs: list[tuple[int, int]] = []
    for side in "LR":
        inner, outer = (column.get(side + place) for place in ("WRA", "WRB"))
        shoulders = (_mean(points, column, side, names) for names in _SHOULDERS)
        shoulder = next((found for found in shoulders if found is not None), None)
        elbow = _mean(points, column, side, _ELBOWS)
        if inner is None or outer is None or shoulder is None or elbow is None:
            continue
        if _towards_upper_arm(points[:, inner], points[:, outer], shoulder, elbow) < EXCHANGED:
            pairs.append((inner, outer))
    return pairs


def with_wrists_named(clouds: Sequence[MarkerCloud], own: Mapping[str, str]) -> NamesOverTakes:
    """Return takes whose wrists' markers have their own names, and what was changed.

    Args:
        clouds: labelled takes.
        own: the user's place by label, which is not changed.
    """
    takes, changes = list(clouds), list[NameChange]()
    for number, cloud in enumerate(clouds):
        labels = cloud.labels or ()
        known = name_markers([label for label in labels if not is_unnamed(label)], own).known
        for a, b in exchanged_wrists(cloud.positions, [known.get(label, "") for label in labels]):
            if {labels[a], labels[b]} & set(own):
                continue
            takes[number] = with_exchanged(takes[number], labels[a], labels[b])
            changes.append(NameChange(number, labels[a], labels[b], mended=True))
    return NamesOverTakes(tuple(takes), tuple(changes))


def _towards_upper_arm(inner: np.ndarray, outer: np.ndarray, shoulder: np.ndarray, elbow: np.ndarray) -> float:
    """Return the median cosine of the wrist's line and the upper arm's direction across the forearm; 1 if unknown."""
    forearm = 0.5 * (inner + outer) - elbow
    forearm = forearm / np.maximum(np.linalg.norm(forearm, axis=-1, keepdims=True), 1e-9)
    upper = shoulder - elbow
    across = upper - (upper * forearm).sum(-1, keepdims=True) * forearm
    size, line = np.linalg.norm(across, axis=-1), inner - outer
    cosine = (line * across).sum(-1) / np.maximum(size * np.linalg.norm(line, axis=-1), 1e-9)
    bent = np.isfinite(cosine) & (size > BENT * np.linalg.norm(upper, axis=-1))
    return float(quantile(cosine[bent], 0.5, axis=0)) if bent.sum() >= LEAST_FRAMES else 1.0


def _mean(points: np.ndarray, column: dict[str, int], side: str, names: Sequence[str]) -> np.ndarray | None:
    chosen = [column[side + name] for name in names if side + name in column]
    return points[:, chosen].mean(axis=1) if chosen else None
