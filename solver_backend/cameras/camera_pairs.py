"""Which pairs of cameras are compared: all of a few, of many so many around each."""

from __future__ import annotations

COMPARED = 16
"""Cameras up to which every pair is compared where a pair costs little."""


def compared_pairs(count: int, each: int = COMPARED, neighbours: int = 0) -> list[tuple[int, int]]:
    """Return pairs (i < j) of cameras in rising order.

    Of more than ``each`` cameras every one is compared with its ``neighbours`` that follow, the first after the last:
    all hang together, and the work grows with the number of cameras instead of its square.

    Args:
        count: cameras.
        each: cameras up to which all pairs are returned.
        neighbours: ``each - 1`` if 0.
    """
    others = range(1, count if count <= each else (neighbours or each - 1) + 1)
    return sorted({(min(c, d), max(c, d)) for c in range(count) for k in others if (d := (c + k) % count) != c})
