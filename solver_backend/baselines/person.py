"""What all body baselines start from, the same for each: triangulated points, noise, and a fixed shape.

The thesis seeds shape and first frame with an HMR regressor (6.3.2); here both come from fits to triangulated points
of frames spread over the take, which is the kinder start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.baselines.base import BaselineResult
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.exchange.progress import silent
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.output.build_motion import build_motion
from solver_backend.fitters.problem import Problem, learn_subject
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.start import observe
from solver_backend.priors.sposer import load_sposer
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.types import Capture

ROBUST_SCALE = 3.0
"""Final Geman-McClure scale of every method, in standard deviations of the detector's noise."""


@dataclass(frozen=True)
class Prepared:
    """A capture made ready, and the person with a shape that stays."""

    capture: Capture
    problem: Problem
    subject: Subject

    @property
    def seen(self) -> np.ndarray:
        """Return the frames in which a body can be placed."""
        return np.flatnonzero(self.problem.observations.seen)

    def result(
        self, name: str, frames: PosedFrames, key_times: np.ndarray | None = None, statistics: dict | None = None
    ) -> BaselineResult:
        """Return the poses of all frames as a result."""
        motion = build_motion(
            self.capture, self.subject, frames, self.problem.observations, covariance=None, scale=ROBUST_SCALE,
            key_times=np.arange(0) if key_times is None else key_times, provenance={"baseline": name},
        )  # fmt: skip
        assert motion.keypoints3d is not None
        return BaselineResult(motion.keypoints3d, motion, statistics or {})


def prepare(capture: Capture) -> Prepared:
    """Triangulate, measure the noise and fit the shape.

    Raises:
        TooFewViews, NoDetections: nothing can be triangulated.
    """
    cameras, keypoints = capture.require_multiview()
    observations = observe(cameras, keypoints)
    if not observations.seen.any():
        raise NoDetections("In no frame do two cameras agree on enough keypoints to place a body.", where=capture.name)
    body, prior, like = load_body(), load_sposer(), np.zeros(1)
    term = ReprojectionTerm.of(cameras, keypoints, observations.sigma_px, like)
    problem = Problem(body, prior, observations, term, keypoints.fps, keypoints.num_frames, capture)
    landmarks = keypoint_landmarks(body, keypoints.joint_set)
    subject = Subject(body, landmarks, np.zeros(10), np.zeros((len(landmarks), 3)))
    return Prepared(capture, problem, learn_subject(problem, subject, SolveSettings(), silent))
