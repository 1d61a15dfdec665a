"""Rigid bodies whose poses a file holds, without their markers: each becomes the four points of its axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.props import POSE_POINTS
from solver_backend.types import MarkerCloud

ARM_M = 0.1
"""From a body's origin to the points on its axes: markers on things that people hold are about so far apart."""


@dataclass(frozen=True)
class RigidBodies:
    """B rigid bodies over F frames, in the unit and axes of their file."""

    names: tuple[str, ...]
    """One a body."""
    positions: np.ndarray
    """(F, B, 3) their origins, NaN where a body is not seen."""
    rotations: np.ndarray
    """(F, B, 3, 3) from each body's axes to the file's."""

    def kept(self, chosen: list[int]) -> RigidBodies:
        """Return some of them."""
        names = tuple(self.names[i] for i in chosen)
        return RigidBodies(names, self.positions[:, chosen], self.rotations[:, chosen])

    def points(self, metres: float, to_world: np.ndarray, fps: float) -> MarkerCloud:
        """Return each body's origin and a point on each of its axes, labelled ``NAME:origin``, ``NAME:x`` and so on.

        Args:
            metres: a unit of the file.
            to_world: (3, 3) from the file's axes to the world's.
            fps: frames per second.
        """
        origins = metres * self.positions @ to_world.T
        arms = ARM_M * np.swapaxes(to_world @ self.rotations, -1, -2)
        points = np.concatenate([origins[:, :, None], origins[:, :, None] + arms], axis=2)
        points = np.where(np.isfinite(points).all((-2, -1), keepdims=True), points, np.nan)
        labels = tuple(f"{name}:{point}" for name in self.names for point in POSE_POINTS)
        return MarkerCloud(points.reshape(len(points), -1, 3), fps, labels)
