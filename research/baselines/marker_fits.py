"""Fit a body to markers, for comparison with the noise-aware method (thesis 5.3.1)."""

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
from solver_backend.residuals.landmark_loss import FixedVariances, LandmarkCost, LandmarkLoss
from solver_backend.types import Capture, Motion

_SIMPLIFIED = "Markers stay where their layout has them, codes of RVPoser, no hands and no velocities"


@dataclass(frozen=True)
class AdaptiveLoss:
    """Barron's general loss ``|α - 2|/α ((r²/c² / |α - 2| + 1)^(α/2) - 1)`` with a fixed shape α.

    α = 2 gives least squares, 0 Cauchy's loss, and -2 Geman-McClure's. Lower values reduce the weight of outliers
    (Barron 2019, "A general and adaptive robust loss function", eqs. 1, 8 and 9).
    """

    alpha: float
    scale: float = 1.0  # c, in initial standard deviations.

    def unknowns(self, num_landmarks: int) -> int:
        """Return the number of unknowns of the loss, which is 0 because its shape is fixed."""
        return 0

    def __call__(self, squared: np.ndarray, seen: np.ndarray, own: np.ndarray) -> LandmarkCost:
        """Return the robust cost of squared landmark distances (F, L)."""
        used, inverse = seen.astype(np.float64), self.scale**-2
        ratio, distance = inverse * np.where(seen, squared, 0.0), abs(self.alpha - 2.0)
        if distance == 0.0:
            cost, slope = 0.5 * ratio, np.full_like(ratio, 0.5)
        elif self.alpha == 0.0:
            cost, slope = np.log1p(0.5 * ratio), 0.5 / (1.0 + 0.5 * ratio)
        else:
            base = ratio / distance + 1.0
            cost = distance / self.alpha * (base ** (0.5 * self.alpha) - 1.0)
            slope = 0.5 * base ** (0.5 * self.alpha - 1.0)
        return LandmarkCost((used * cost).sum(-1), inverse * used * slope, np.zeros_like(own))


class MarkerBaseline(Baseline):
    """The noise-aware method's two stages, with another loss in the second stage."""

    @property
    @abstractmethod
    def loss(self) -> LandmarkLoss:
        """Loss of the second stage."""

    def solve(self, capture: Capture) -> BaselineResult:
        """Fit the known markers of a capture.

        Raises:
            MarkersUnknown: there are no markers, or too few markers of a known layout.
            NoDetections: no frame has enough markers to locate a body.
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
        """Fit the body to measured landmarks with this loss."""
        subject = Subject.average(problem.body, problem.measurements.landmarks, np.zeros(1))
        settings = SolveSettings(method="noise-aware")
        solved, _ = solve_noise_aware(problem, subject, settings, silent, loss=self.loss)
        return build_motion(
            problem.measurements, solved, scale=settings.robust_scale, provenance={"baseline": self.name}
        )


@dataclass(frozen=True)
class MoSh(MarkerBaseline):
    """MoSh++ (Mahmood et al. 2019) as in thesis 5.3.1: unweighted least squares in both stages."""

    name: str = "MoSh++"
    simplified: str = f"{_SIMPLIFIED}."

    @property
    def loss(self) -> LandmarkLoss:
        """Least squares, with equal weights for all landmarks."""
        return FixedVariances()


@dataclass(frozen=True)
class AdaptiveRobust(MarkerBaseline):
    """Barron's adaptive loss (2019) with a shape α from a grid search, as in thesis 5.3.1."""

    alpha: float = -1.0  # Shape α of the loss. In the thesis, -4.5 was best.
    name: str = "Barron's loss"
    simplified: str = f"{_SIMPLIFIED}."

    @property
    def loss(self) -> LandmarkLoss:
        """Barron's loss, with less weight for distant landmarks."""
        return AdaptiveLoss(self.alpha)
