"""Left and right as a detector exchanges them in one view for a while: put back where the person is expected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

CLEARLY = 0.5
"""A limb pair is exchanged where that brings it nearer than this share of its distance as it is."""
FAR = 0.08
"""Share of the person's size in the picture within which a pair is never exchanged: limbs that cross lie as near."""
_PARTS = {
    "arms": ("shoulder", "elbow", "wrist", "thumb", "index", "pinky"),
    "legs": ("hip", "knee", "ankle", "heel", "big_toe", "small_toe", "foot_index"),
    "head": ("eye", "eye_inner", "eye_outer", "ear", "mouth"),
}
_FEWEST = 2
"""Seen keypoints of a pair without which no decision on it is made."""


class ExchangedSides:
    """Finds pairs of limbs whose sides are exchanged, among a detector's keypoints."""

    def __init__(self, names: Sequence[str]) -> None:
        """Take the names of K keypoints."""
        rows = {name: row for row, name in enumerate(names)}
        self._pairs: list[tuple[np.ndarray, np.ndarray]] = []
        for parts in _PARTS.values():
            there = [part for part in parts if f"left_{part}" in rows and f"right_{part}" in rows]
            sides = [[rows[f"{side}_{part}"] for part in there] for side in ("left", "right")]
            own, other = [*sides[0], *sides[1]], [*sides[1], *sides[0]]
            if there:
                self._pairs.append((np.array(own), np.array(other)))

    def put_back(self, seen: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, int]:
        """Return one view's (K, 3) keypoints with exchanged pairs put back, and how many pairs were.

        Args:
            seen: (K, 3) x, y and confidence, NaN or confidence 0 where missing.
            expected: (K, 2) px where the person is expected, NaN where nothing is.
        """
        size = float(np.linalg.norm(np.nanmax(expected, axis=0) - np.nanmin(expected, axis=0)))
        found, count = seen.copy(), 0
        for own, other in self._pairs:
            there = np.isfinite(seen[own]).all(-1) & (seen[own, 2] > 0)
            if there.sum() < _FEWEST:
                continue
            as_is, exchanged = (
                np.nanmedian(np.linalg.norm(seen[own[there], :2] - expected[to[there]], axis=-1)) for to in (own, other)
            )
            if as_is > FAR * size and exchanged < CLEARLY * as_is:
                found[other] = seen[own]
                count += 1
        return found, count
