"""Find the length unit of a file of markers: stated, or estimated from the markers' size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.geometry.arrays import quantile
from solver_backend.io.recognition.marker_up_axis import raised_part

METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}  # Metres in a unit.


def metres_in(unit: str) -> float:
    """Return the metres in a unit.

    Raises:
        JobInvalid: the unit is unknown.
    """
    if unit not in METRES:
        raise JobInvalid(
            f"Unknown unit '{unit}'; known are {', '.join(METRES)}.", where="unit",
            hint="A unit of its own, such as the squares of a board, is a number of metres: --scale.",
        )  # fmt: skip
    return METRES[unit]


SMALLEST_M, LARGEST_M = 0.03, 30.0
"""Markers that spread less or more than this over most frames were not recorded in the unit that the file states."""
PERSON_M = (0.25, 4.0)  # Spread of the markers of a person, in metres.
STATED_FACTOR = 2.0
"""By so much more than people's may parts of a body be apart in the unit that a file states, as with two people in it:
units that are taken for another are mostly ten times as large."""

_STARTS = {"mm": "mm", "mil": "mm", "cm": "cm", "cen": "cm", "m": "m", "met": "m", "in": "inch", "f": "foot"}
"""Units by how their names begin: files have mm, Millimeters, METERS, mete, m, inches, ft."""


@dataclass(frozen=True)
class Unit:
    """A length unit and how it was found."""

    name: str  # A key of ``METRES``.
    note: Diagnostic  # How it was found.
    problem: Diagnostic | None = None  # What is wrong with the file's own statement, None if nothing is.

    @property
    def metres(self) -> float:
        """Metres in the unit."""
        return METRES[self.name]


def unit_named(text: str) -> str | None:
    """Return the key of ``METRES`` that a file's word means, None where it means none."""
    word = text.strip().lower()
    if word in METRES:
        return word
    starts = [start for start in _STARTS if word.startswith(start)]
    return _STARTS[max(starts, key=len)] if starts else None


def spread(positions: np.ndarray) -> float:
    """Return the largest side of the box around most markers, the median over frames. NaN where none are seen."""
    frames = positions[:: max(1, len(positions) // 200)]
    sides = quantile(frames, 0.9, 1, "nearest") - quantile(frames, 0.1, 1, "nearest")
    return float(quantile(sides.max(axis=-1), 0.5, 0, "nearest"))


def find_unit(positions: np.ndarray, stated: str, given: str | None, default: str, labels: Sequence[str] = ()) -> Unit:
    """Return the unit of positions.

    The user's unit wins, then the file's unless markers then spread over less than ``SMALLEST_M`` or more than
    ``LARGEST_M``, or the parts that labels name are no person's distance apart, then the unit in which they have a
    person's size.

    Args:
        positions: (F, M, 3) in the file's unit.
        stated: the file's word for it, empty if there is none.
        given: by the user.
        default: what the format's files are mostly in.
        labels: of the markers.

    Raises:
        JobInvalid: the given unit is unknown.
    """
    if given is not None:
        metres_in(given)
        return _unit(given, "given")
    size = spread(positions)
    name = unit_named(stated)
    raised, (least, usual, most) = raised_part(positions, labels)
    apart = np.nan if raised is None else float(quantile(np.linalg.norm(raised, axis=-1), 0.5, 0, "nearest"))

    def fits(unit: str, low: float, high: float, factor: float = 1.0) -> bool:
        body = not np.isfinite(apart) or least / factor <= apart * METRES[unit] <= most * factor
        return low <= size * METRES[unit] <= high and body

    if name is not None and not (size > 0 and not fits(name, SMALLEST_M, LARGEST_M, STATED_FACTOR)):
        return _unit(name, "file")
    units = (default, "mm", "m", "cm")
    if np.isfinite(apart):  # inches of an adult are centimetres of one who crouches
        units = tuple(sorted(METRES, key=lambda unit: abs(np.log(max(apart, 1e-9) * METRES[unit] / usual))))
    for other in dict.fromkeys(units):
        if fits(other, *PERSON_M):
            if name is None:
                return Unit(other, diagnostic("unit_read", source="spread", unit=other, spread=size))
            problem = diagnostic("marker_unit_not_as_stated", stated=name, spread=size * METRES[name], unit=other)
            return _unit(other, "corrected", problem)
    if name is not None:
        problem = diagnostic("marker_spread_unlikely", likely="file", spread=size * METRES[name])
        return _unit(name, "file", problem)
    return _unit(default, "kind")


def _unit(name: str, source: str, problem: Diagnostic | None = None) -> Unit:
    return Unit(name, diagnostic("unit_read", source=source, unit=name), problem)
