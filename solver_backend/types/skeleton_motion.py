"""A motion of a foreign skeleton, as BVH and other clips hold it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SkeletonMotion:
    """F frames of J joints; metres, world Z up. Rest places are in the skeleton's own axes."""

    name: str
    """Name of the take."""
    names: tuple[str, ...]
    """J joints, parents before children; places where a chain ends count as joints and are named after their parent."""
    parents: tuple[int, ...]
    """Parent of each joint, -1 at the root."""
    rest: np.ndarray
    """(J, 3) places where no joint turns."""
    joints: np.ndarray
    """(F, J, 3) places."""
    turns: np.ndarray
    """(F, J, 3, 3) rotations from the rest axes to the world."""
    fps: float
    """Frames per second."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.joints)
