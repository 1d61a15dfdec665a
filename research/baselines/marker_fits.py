"""Fits of a body to markers, which the noise-aware method is compared with (thesis 5.3.1)."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from research.baselines.base import Baseline, BaselineResult
from solver_backend.body.body import load_body
from solver_backend.exchange.errors import MarkersUnknown
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import build_motion
from solver_backend.fitters.measurements.markers import known_markers_of, measure_markers
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.noise_aware import solve_noise_aware
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.landmark_loss import AdaptiveLoss, FixedVariances, LandmarkLoss
from solver_backend.types import Capture, Motion

_SIMPLIFIED = "Markers stay where their layout has them, codes of RVPoser, no hands and no velocities"


class MarkerBaseline(Baseline):
    """The two stages of the noise-aware method with another loss in the second."""

    @property
    @abstractmethod
    def loss(self) -> LandmarkLoss:
        """Of the second stage."""

    def solve(self, capture: Capture) -> BaselineResult:
        """Fit the known markers of a capture.

        Raises:
            MarkersUnknown: there are no markers, or too few that a layout knows.
            NoDetections: in no frame enough markers are there to place a body.
        """
        if capture.markers is None:
            raise MarkersUnknown(
                f"{self.name} fits markers, and the capture has none.", where=capture.name, hint="Choose a marker take."
            )
        body = load_body()
        measured = measure_markers(known_markers_of(capture.markers), body, np.zeros(1))
        motion = self.motion_of(Problem.of(body, load_sposer(), measured))
        assert motion.markers is not None
        return BaselineResult(motion.markers, motion)

    def motion_of(self, problem: Problem) -> Motion:
        """Fit landmarks that are measured already."""
        subject = Subject.average(problem.body, problem.measurements.landmarks, np.zeros(1))
        settings = SolveSettings(method="noise-aware")
        solved, _ = solve_noise_aware(problem, subject, settings, silent, loss=self.loss)
        return build_motion(
            problem.measurements, solved, scale=settings.robust_scale, provenance={"baseline": self.name}
        )


@dataclass(frozen=True)
class MoSh(MarkerBaseline):
    """MoSh++ (Mahmood et al. 2019) as thesis 5.3.1 has it: unweighted least squares, also in the second stage."""

    name: str = "MoSh++"
    simplified: str = f"{_SIMPLIFIED}."

    @property
    def loss(self) -> LandmarkLoss:
        """Every landmark counts alike."""
        return FixedVariances()


@dataclass(frozen=True)
class AdaptiveRobust(MarkerBaseline):
    """Barron's adaptive loss (2019) with a shape α that a grid search chose, as thesis 5.3.1 has it."""

    alpha: float = -1.0  # Shape; of the thesis's search the best is -4.5.
    name: str = "Barron's loss"
    simplified: str = f"{_SIMPLIFIED}."

    @property
    def loss(self) -> LandmarkLoss:
        """Far landmarks count less."""
        return AdaptiveLoss(self.alpha)
