"""Prepare the common start of all body baselines: triangulated points, noise and a fixed shape.

The thesis initialises shape and first frame with an HMR regressor (6.3.2). Here both come from fits to triangulated
points in frames spread over the take, which gives the baselines better results.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from research.baselines.base import Baseline, BaselineResult
from solver_backend.body.body import load_body
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import build_motion
from solver_backend.fitters.measurements.views import measurements_of
from solver_backend.fitters.model.subject import PosedFrames, Subject
from solver_backend.fitters.person_shape import learn_subject
from solver_backend.fitters.problem import Problem, SolvedFrames
from solver_backend.priors.sposer import load_sposer
from solver_backend.types import Capture

ROBUST_SCALE = 3.0  # Final Geman-McClure scale of all methods, in standard deviations of the detector's noise.


@dataclass(frozen=True)
class Prepared:
    """A capture with measured keypoints and noise, and a person with a fixed shape."""

    problem: Problem
    subject: Subject

    @property
    def seen(self) -> np.ndarray:
        """Indices of the frames with enough points to locate a body."""
        return np.flatnonzero(self.problem.measurements.seen)

    def result(
        self, name: str, frames: PosedFrames, key_times: np.ndarray | None = None, statistics: dict | None = None
    ) -> BaselineResult:
        """Convert the poses of all frames to a baseline's result."""
        times = np.arange(0) if key_times is None else key_times
        motion = build_motion(
            self.problem.measurements,
            SolvedFrames(self.subject, frames, times),
            scale=ROBUST_SCALE,
            provenance={"baseline": name},
        )
        assert motion.keypoints3d is not None
        return BaselineResult(motion.keypoints3d, motion, statistics or {})


class BodyBaseline(Baseline):
    """A baseline that fits a body to a prepared capture."""

    def solve(self, capture: Capture) -> BaselineResult:
        """Prepare the capture and fit it."""
        return self.fit(prepare(capture))

    @abstractmethod
    def fit(self, prepared: Prepared) -> BaselineResult:
        """Fit the body to a prepared capture."""


def prepare(capture: Capture) -> Prepared:
    """Triangulate the keypoints of a capture, measure their noise, and fit the body shape.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
    """
    cameras, keypoints = capture.require_multiview()
    body, like = load_body(), np.zeros(1)
    triangulation = triangulate(cameras, keypoints.xy, keypoints.confidence)
    # The baselines' weights were tuned with no other noise than the detector's.
    measurements = measurements_of(capture, triangulation, body, like, model_error=False)
    # Published methods already have a prior. Our mixture of poses would be a second one.
    problem = replace(Problem.of(body, load_sposer(), measurements), pose_terms=())
    subject = Subject.average(body, problem.measurements.landmarks, like)
    return Prepared(problem, learn_subject(problem, subject, SolveSettings(), silent))
