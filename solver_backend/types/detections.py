"""Define the output of keypoint detectors for all people of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.types.capture import Keypoints2D, OwnPoint, stacked_hands


@dataclass(frozen=True)
class Detections:
    """Output of the detectors for C cameras, F frames, up to P people and K keypoints."""

    cameras: tuple[str, ...]  # Name of each camera's folder.
    xy: np.ndarray  # (C, F, P, K, 2) float32 pixels. NaN where a keypoint or a person is missing.
    confidence: np.ndarray  # (C, F, P, K) float32 in 0..1. 0 where missing.
    joint_set: JointSet  # Names of the keypoints.
    hands: np.ndarray | None = None
    """(C, F, P, 2, 21, 3) float32 x, y and confidence of hands, left first. None if no file has any."""
    first_frame: int = 0  # Number of the first frame in the files.
    first_frames: tuple[int, ...] = ()
    """First frame of each camera if they differ, otherwise empty."""
    lengths: tuple[int, ...] = ()  # Frames of each camera. Empty if all have the same number.
    own: tuple[OwnPoint, ...] = ()  # Additional keypoints after the joint set.
    notes: tuple[Diagnostic, ...] = ()  # Findings and assumptions.
    problems: tuple[Diagnostic, ...] = ()  # Warnings for the user.

    @classmethod
    def of_people(cls, cameras: tuple[str, ...], people: Sequence[Keypoints2D]) -> Detections:
        """Combine the keypoints of several people, who have the same keypoint names, into detections."""
        xy, confidence = (np.stack(each, axis=2) for each in zip(*((p.xy, p.confidence) for p in people), strict=True))
        hands = stacked_hands([person.hands for person in people], axis=2)
        return cls(cameras, xy, confidence, people[0].joint_set, hands, own=people[0].own)

    @property
    def num_frames(self) -> int:
        """Number of frames of the longest camera. Shorter cameras have empty frames at the end."""
        return self.xy.shape[1]

    @property
    def starts(self) -> np.ndarray:
        """(C,) number of each camera's first frame in its files."""
        return np.array(self.first_frames or [self.first_frame] * len(self.cameras))

    @property
    def counts(self) -> np.ndarray:
        """(C,) number of frames that each camera recorded."""
        return np.array(self.lengths or [self.num_frames] * len(self.cameras))

    def people(self) -> np.ndarray:
        """Return the (C, F) number of people detected in each view and frame."""
        return (self.confidence > 0).any(axis=-1).sum(axis=-1)
