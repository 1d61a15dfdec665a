"""Detections of everybody in every view, before one person is chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.types import JointSet, OwnPoint


@dataclass(frozen=True)
class Detections:
    """What the detectors wrote: C cameras, F frames, up to P people, K keypoints."""

    cameras: tuple[str, ...]
    """One name a camera, as the folders are called."""
    xy: np.ndarray
    """(C, F, P, K, 2) float32 pixels; NaN where a keypoint or a person is missing."""
    confidence: np.ndarray
    """(C, F, P, K) float32 in 0..1; 0 where missing."""
    joint_set: JointSet
    """Names of the keypoints."""
    hands: np.ndarray | None = None
    """(C, F, P, 2, 21, 3) float32 x, y and confidence of hands, left first; None where no file holds any."""
    first_frame: int = 0
    """The number of the first frame in the files' own numbering."""
    first_frames: tuple[int, ...] = ()
    """The same of each camera, where each was read from its own first; () where all begin with ``first_frame``."""
    lengths: tuple[int, ...] = ()
    """Frames from each camera's first to its last, then; () where all have as many."""
    own: tuple[OwnPoint, ...] = ()
    """Keypoints behind those of the joint set."""
    notes: tuple[Diagnostic, ...] = ()
    """What was found and assumed."""
    problems: tuple[Diagnostic, ...] = ()
    """What the user should know."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.xy.shape[1]

    def people(self) -> np.ndarray:
        """Return (C, F) the number of people found in each view and frame."""
        return (self.confidence > 0).any(axis=-1).sum(axis=-1)
