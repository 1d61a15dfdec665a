"""Hands as gloves record them: angles of fingers beside no body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types.shapes import Float


@dataclass(frozen=True)
class GloveTake:
    """F frames of both hands."""

    name: str
    """Of the recording."""
    times: Float[np.ndarray, " frames"]
    """(F,) seconds from the first frame, rising."""
    angles: Float[np.ndarray, "frames 2 a"]
    """(F, 2, A) radians of the left and the right hand, see ``hand_angles``; NaN where the file does not have them."""
    palms: Float[np.ndarray, "frames 2 3 3"]
    """(F, 2, 3, 3) rotations of the palms in a world of the file's own; NaN where it has none."""

    @property
    def sides(self) -> tuple[int, ...]:
        """Hands that the file has: 0 left, 1 right."""
        return tuple(side for side in range(2) if np.isfinite(self.angles[:, side]).any())
