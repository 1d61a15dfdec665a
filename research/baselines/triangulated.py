"""Implement robust triangulation with a Butterworth low-pass filter, as in most open pipelines."""

from __future__ import annotations

from dataclasses import dataclass

from research.baselines.base import Baseline, BaselineResult
from solver_backend.evaluation.evaluate import triangulate_and_filter
from solver_backend.types import Capture


@dataclass(frozen=True)
class TriangulatedButterworth(Baseline):
    """Triangulates the points and filters them, without fitting a body."""

    cutoff_hz: float = 6.0  # Cutoff of the fourth-order filter.
    name: str = "triangulation + Butterworth"
    simplified: str = ""

    def solve(self, capture: Capture) -> BaselineResult:
        """Triangulate the keypoints of a capture, and filter them."""
        return BaselineResult(triangulate_and_filter(*capture.require_multiview(), self.cutoff_hz))
