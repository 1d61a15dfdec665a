"""Whether left and right labels of legs or arms are exchanged in all of a take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.errors import MarkersMirrored

WAIST = ("FWT", "BWT", "MWT", "GTR")
SHOULDERS = ("SHO", "FSH", "BSH")
LEGS = ("KNE", "MKNE", "SHN", "TIB", "ANK", "MANK", "HEE", "TOE", "MT1", "MT5")
ARMS = ("UPA", "ELB", "MELB")
TOES, HEELS = ("TOE", "MT1", "MT5"), ("HEE", "ANK", "MANK")
"""Places without their side."""
LEAST_PAIRS = 2
"""Pairs of a limb's markers that have to be there."""
MIRRORED, CROSSED_M, SHARE = -0.3, -0.05, 0.75
"""Sine of feet that point backwards; metres by which left legs are on the right, and in which share of the frames. In
45 recordings the sine's median is above 0.5, and left legs are 0.12 m on the left in a quarter of the frames at
least."""


def check_sides(points: np.ndarray, landmarks: Landmarks) -> None:
    """Make sure that left legs and arms are on the left of waist and shoulders, and that feet point forward.

    With l from the right to the left side, u from the feet to the waist and f from heels to toes, ``(l × u) · f > 0``.

    Args:
        points: (F, L, 3) metres, NaN where missing.
        landmarks: the L places.

    Raises:
        MarkersMirrored: it is not so in most frames.
    """
    column = {name: i for i, name in enumerate(landmarks.names)}
    for base, limb, which in ((WAIST, LEGS, "legs"), (SHOULDERS, ARMS, "arms")):
        own, beyond = (_lateral(points, column, places, least) for places, least in ((base, 1), (limb, LEAST_PAIRS)))
        if own is not None and beyond is not None and _usual((_unit(own) * beyond).sum(-1), SHARE) < CROSSED_M:
            raise MarkersMirrored(
                f"The {which}' left markers are on the right of the body: their left and right labels are exchanged.",
                where="markers", hint=f"Exchange L and R in the labels of the {which}.",
            )  # fmt: skip
    lateral = _lateral(points, column, WAIST, 1)
    lateral = _lateral(points, column, LEGS, LEAST_PAIRS) if lateral is None else lateral
    waist, feet = (_mean(points, column, _both(places)) for places in (WAIST, (*TOES, *HEELS)))
    forward = [_along(points, column, side) for side in "LR"]
    known = [step for step in forward if step is not None]
    if lateral is None or waist is None or feet is None or not known:
        return
    across = np.cross(_unit(lateral), _unit(waist - feet))
    if _usual(np.stack([(across * step).sum(-1) for step in known])) < MIRRORED:
        raise MarkersMirrored(
            "The legs' markers are a mirror image of a body's: left and right labels are exchanged, or an axis points "
            "the other way.", where="markers",
            hint="Exchange L and R in the labels, or export the take with right-handed axes.",
        )  # fmt: skip


def _lateral(points: np.ndarray, column: dict[str, int], places: Sequence[str], least: int) -> np.ndarray | None:
    """Return (F, 3) metres from the right to the left, the mean of pairs; None where there are too few."""
    there = [place for place in places if {"L" + place, "R" + place} <= column.keys()]
    pairs = [(column["L" + place], column["R" + place]) for place in there]
    if len(pairs) < least:
        return None
    return np.mean([points[:, left] - points[:, right] for left, right in pairs], axis=0)


def _along(points: np.ndarray, column: dict[str, int], side: str) -> np.ndarray | None:
    """Return (F, 3) unit directions from a foot's heel to its toes; None without both."""
    toes, heel = (_mean(points, column, [side + place for place in places]) for places in (TOES, HEELS))
    return None if toes is None or heel is None else _unit(toes - heel)


def _mean(points: np.ndarray, column: dict[str, int], names: Sequence[str]) -> np.ndarray | None:
    """Return (F, 3) means of the places that are there; None where none is."""
    chosen = [column[name] for name in names if name in column]
    return points[:, chosen].mean(axis=1) if chosen else None


def _both(places: Sequence[str]) -> list[str]:
    return [side + place for side in "LR" for place in places]


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def _usual(values: np.ndarray, share: float = 0.5) -> float:
    """Return the quantile of what is known; 1 where nothing is."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if known.size else 1.0
