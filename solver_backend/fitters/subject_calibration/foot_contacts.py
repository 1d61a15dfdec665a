"""Planted points of the feet, read from a first solution."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np

from solver_backend.exchange.stands import stands, steps
from solver_backend.geometry.arrays import Array
from solver_backend.residuals.positions import SIGMA_M, PositionTerm, foot_contact_term

ALONG_SIGHT = 3.0
"""Factor of the speed limit along the line of sight of a single camera, which sees no depth. On 48 filmed takes of
subjects 08, 60 and of some that the lifter is trained on, feet skate by 0.011 cm a frame instead of 0.012 and joints
are 0.1 mm nearer, with 2 as with 4. On the benchmark's own takes a foot goes deeper below the floor with 4."""
_FOOT_POINTS = ("big_toe", "small_toe", "heel", "HEE", "TOE", "MT1", "MT5", "HAL")
"""A detector's keypoints and places of markers, without their side."""
_SIDES = (("left_", "L"), ("right_", "R"))


@dataclass(frozen=True)
class Contacts:
    """Planted points of the feet."""

    planted: np.ndarray  # (F, L) bool.
    anchors: np.ndarray  # (F, L, 3) metres: the mean position of each stand, 0 elsewhere.

    def feet(self, names: tuple[str, ...]) -> np.ndarray | None:
        """Return (F, 2) bool: a point of the left and of the right foot is planted, None where no point is a foot's."""
        feet = _foot_columns(names)
        if not feet:
            return None
        sides = [[k for k in feet if names[k].startswith(side)] for side in _SIDES]
        return np.stack([self.planted[:, columns].any(axis=1) for columns in sides], axis=1)

    def term(self, like: Array, firmness: float = 1.0) -> PositionTerm:
        """Return the term that draws the planted points to their anchors; firmness divides its deviation."""
        return foot_contact_term(self.planted, self.anchors, like, SIGMA_M / firmness)


def find_contacts(
    points: np.ndarray,
    names: tuple[str, ...],
    fps: float,
    fixed: np.ndarray | None = None,
    sight: np.ndarray | None = None,
) -> Contacts:
    """Find the frame ranges in which points of the feet are slow and low.

    Args:
        points: (F, L, 3) solved positions, metres, Z up.
        fixed: (F,) bool, frames that will not move: a stand that includes some is where they are.
        sight: (F, 3) unit direction of the one camera that sees the person, None where several do.
    """
    fixed = np.zeros(len(points), dtype=bool) if fixed is None else fixed
    columns = _foot_columns(names)
    planted, anchors = np.zeros(points.shape[:2], dtype=bool), np.zeros(points.shape)
    if len(points) < 3 or not columns:
        return Contacts(planted, anchors)
    feet = points[:, columns]
    way, seconds = steps(feet, fps)
    if sight is not None:
        along = np.einsum("fka,fa->fk", way, sight)[..., None] * sight[:, None]
        way = way - (1.0 - 1.0 / ALONG_SIGHT) * along
    for place, runs in enumerate(stands(feet[..., 2], np.linalg.norm(way, axis=-1) / seconds, fps)):
        for first, stop in runs:
            planted[first:stop, columns[place]] = True
            sure = fixed[first:stop] if fixed[first:stop].any() else slice(None)
            anchors[first:stop, columns[place]] = feet[first:stop, place][sure].mean(axis=0)
    return Contacts(planted, anchors)


def _foot_columns(names: tuple[str, ...]) -> list[int]:
    feet = {side + point for side in chain(*_SIDES) for point in _FOOT_POINTS}
    return [k for k, name in enumerate(names) if name in feet]
