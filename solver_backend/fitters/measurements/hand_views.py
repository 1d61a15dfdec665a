"""The hands that views show of one person."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types import Cameras, Keypoints2D


@dataclass(frozen=True)
class HandViews:
    """Detected points of both hands in C views over F frames."""

    cameras: Cameras
    """C calibrated cameras."""
    xy: np.ndarray
    """(C, F, 2, 21, 2) px, left hand first; NaN where unseen."""
    confidence: np.ndarray
    """(C, F, 2, 21) in 0..1, 0 where unseen."""

    @classmethod
    def of(cls, cameras: Cameras, keypoints: Keypoints2D) -> HandViews | None:
        """Return the hands of a person; None where no view shows any.

        A view that was left out for what it shows of the body is left out with its hands.
        """
        if keypoints.hands is None:
            return None
        with_body = (keypoints.confidence > 0).any(axis=-1)[..., None, None]
        confidence = np.where(with_body, keypoints.hands[..., 2], 0.0)
        return cls(cameras, keypoints.hands[..., :2], confidence) if confidence.any() else None
