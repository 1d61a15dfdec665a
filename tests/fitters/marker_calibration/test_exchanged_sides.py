"""Left and right exchanged in a part of a marker set: refused with what is exchanged, and correct sets pass."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import MarkersMirrored
from solver_backend.fitters.marker_calibration.exchanged_sides import check_sides
from tests.support.worn_markers import worn_markers

LOWER = ("FWT", "BWT", "THI", "KNE", "SHN", "ANK", "HEE", "TOE", "MT5")
UPPER = ("SHO", "UPA", "ELB", "FRM", "WRA")


def a_take(places: tuple[str, ...]) -> tuple[np.ndarray, tuple[str, ...]]:
    names = tuple(side + place for place in places for side in "LR")
    return worn_markers(names, 24, fps=15.0, step=8).cloud.positions, names


def exchanged(names: tuple[str, ...], places: tuple[str, ...]) -> tuple[str, ...]:
    return tuple({"L": "R", "R": "L"}[name[0]] + name[1:] if name[1:] in places else name for name in names)


@pytest.mark.parametrize(
    ("places", "turned", "message"),
    [
        (LOWER, (), ""), (UPPER, (), ""), (("KNE", "ANK", "HEE", "TOE"), (), ""),
        (LOWER, LOWER, "legs' markers are a mirror image"), (LOWER, LOWER[2:], "legs' left markers are on the right"),
        (UPPER, UPPER[1:], "arms' left markers are on the right"),
    ],
)  # fmt: skip
def test_sides(places: tuple[str, ...], turned: tuple[str, ...], message: str) -> None:
    points, names = a_take(places)
    landmarks = marker_landmarks(load_body(), exchanged(names, turned))
    points[::7, 1] = np.nan
    if not message:
        check_sides(points, landmarks)
        return
    with pytest.raises(MarkersMirrored, match=message):
        check_sides(points, landmarks)
