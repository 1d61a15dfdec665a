"""The own points of a user that views show of one person, beside the keypoints of a joint set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.triangulation.triangulate import Triangulation
from solver_backend.types import Cameras, Keypoints2D, OwnPoint


@dataclass(frozen=True)
class OwnViews:
    """K keypoints and N own points in C views over F frames."""

    cameras: Cameras
    """C calibrated cameras."""
    keypoints: Keypoints2D
    """All K + N."""
    points: np.ndarray
    """(F, K + N, 3) metres, NaN where a point was not located."""
    covariance: np.ndarray
    """(F, K + N, 3, 3) m²."""
    sigma_px: np.ndarray
    """(C, F, K + N) standard deviation of each detection."""

    @classmethod
    def of(
        cls, cameras: Cameras, keypoints: Keypoints2D, located: Triangulation, sigma_px: np.ndarray
    ) -> OwnViews | None:
        """Return the own points of a person, None where there are none.

        Args:
            cameras: C calibrated cameras.
            keypoints: of the person.
            located: these.
            sigma_px: standard deviation of a detection, broadcast against (C, F, K + N).
        """
        if not keypoints.own:
            return None
        sigma_px = np.broadcast_to(sigma_px, keypoints.confidence.shape)
        return cls(cameras, keypoints, np.asarray(located.points), np.asarray(located.covariance), sigma_px)

    def column(self, point: OwnPoint) -> int:
        """Return the column of an own point."""
        return self.keypoints.joint_set.num_keypoints + self.keypoints.own.index(point)
