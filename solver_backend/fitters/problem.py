"""Measurements made ready for a solver: with the body, the prior of poses, and what is minimised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.model.subject import FrameObjective
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.terms import PoseTerm

REFERENCE_FPS = 60.0
"""Windows of the settings are counted in frames of this rate: how fast people move does not depend on the camera."""
SAMPLE_FRAMES = 200
"""Frames at most from which shape, bias and noise are learned between passes."""


@dataclass(frozen=True)
class Problem:
    """Measurements made ready for a solver."""

    body: Body
    """The body model."""
    prior: AutoencodingPrior
    """Decoder of poses."""
    measurements: Measurements
    """What is solved from."""
    pose_terms: tuple[PoseTerm, ...]
    """Further terms that evaluate poses."""

    @classmethod
    def of(cls, body: Body, prior: AutoencodingPrior, measurements: Measurements) -> Problem:
        """Return the problem with the prior on the body's joints, and the mixture of poses that ships with the code.

        Raises:
            PriorInvalid: the prior does not fit itself or the body.
        """
        fitting = prior_on_body(prior, body.layout)
        return cls(body, fitting, measurements, (PoseMixtureTerm.of(fitting.joints),))

    @property
    def objective(self) -> FrameObjective:
        """The objective of all frames, one by one: the data and the pose terms."""
        return FrameObjective((self.measurements.term,), self.pose_terms)

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.measurements.fps

    @property
    def num_frames(self) -> int:
        """F."""
        return self.measurements.num_frames

    @property
    def sample(self) -> np.ndarray:
        """Up to ``SAMPLE_FRAMES`` frame numbers spread over the take."""
        count = self.num_frames
        return np.unique(np.linspace(0, count - 1, min(count, SAMPLE_FRAMES)).astype(int))

    def frames_of(self, window: int, least: int = 2) -> int:
        """Return how many frames of this take last as long as ``window`` frames at 60 a second."""
        return max(least, round(window * self.fps / REFERENCE_FPS))
