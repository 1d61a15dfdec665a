"""Detectors with a name. Each is a worker in ``videos/detect/child/pose_workers``."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NamedDetector:
    """A detector that the user chooses by name."""

    label: str  # In a panel.
    description: str  # A sentence without a full stop.
    worker: str  # Module of ``pose_workers``.
    own_environment: bool = False  # It runs in the Python that Set Up Detector makes. Else in that of the solver.


MEDIAPIPE = "mediapipe"  # The default.
DETECTORS = {
    MEDIAPIPE: NamedDetector(
        "MediaPipe",
        "One person, 33 keypoints; the Python that has it is named in the preferences",
        "mediapipe_pose",
        True,
    )
}
"""By the name that is typed, in small letters."""
