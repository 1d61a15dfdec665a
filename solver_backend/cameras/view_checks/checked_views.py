"""What every check of the views hands on: the detections after it, their triangulation, and what it found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from solver_backend.cameras.triangulation.triangulate import Triangulation
from solver_backend.types import Keypoints2D

Finding = TypeVar("Finding")


@dataclass(frozen=True)
class CheckedViews(Generic[Finding]):
    """Detections of one person after a check of the views."""

    keypoints: Keypoints2D
    """The detections, repaired or without what was excluded."""
    triangulation: Triangulation
    """Of these detections."""
    found: tuple[Finding, ...]
    """What was undone or excluded."""
