"""Which pairs of cameras are compared: all of a few, of many so many around each."""

from __future__ import annotations

COMPARED = 16
"""Cameras up to which every pair is compared where a pair costs little."""


def compared_pairs(count: int, each: int = COMPARED) -> list[tuple[int, int]]:
    """Return pairs (i < j) of cameras in rising order.

    Of more than ``each`` cameras every one is compared with the ``each - 1`` that follow it, the first after the last:
    all hang together, and the work grows with the number of cameras instead of its square.

    Args:
        count: cameras.
        each: cameras up to which all pairs are returned.
    """
    others = range(1, min(count, each))
    return sorted({(min(c, d), max(c, d)) for c in range(count) for k in others if (d := (c + k) % count) != c})
