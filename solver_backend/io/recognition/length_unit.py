"""Units of length that files may be in."""

from __future__ import annotations

from solver_backend.exchange.errors import JobInvalid

METRES: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}
"""Metres in a unit."""


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
