"""Measurements made ready for a solver: with the body, the prior of poses, and what is minimised."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver_backend.body.body import Body
from solver_backend.exchange.diagnostics import Diagnostic
from solver_backend.fitters.layers import Measurements
from solver_backend.fitters.model.states import PosedFrames
from solver_backend.fitters.model.subject import FrameObjective, Subject
from solver_backend.geometry.arrays import Array
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.terms import PoseTerm
from solver_backend.solver.levenberg_marquardt import LMResult
from solver_backend.types import Motion

REFERENCE_FPS = 60.0
"""Windows of the settings are counted in frames of this rate: how fast people move does not depend on the camera."""
SAMPLE_FRAMES = 200
"""Frames at most from which shape, bias and noise are learned between passes."""


@dataclass(frozen=True)
class Problem:
    """Measurements made ready for a solver."""

    body: Body
    prior: AutoencodingPrior
    measurements: Measurements
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


@dataclass(frozen=True)
class Solution:
    """A solved take."""

    motion: Motion
    """The poses and what is known of them."""
    status: str
    """One sentence on how the last pass ended; the motion's provenance holds it too."""


@dataclass(frozen=True)
class Convergence:
    """How the last robust scale of a solve ended, over the parts that were solved one after the other."""

    parts: int
    converged: int
    """Those whose cost no longer changes."""
    iterations: int
    """The most linearisations that one of them took."""

    @classmethod
    def of(cls, result: LMResult[Any]) -> Convergence:
        """Return how one minimisation ended."""
        return cls(1, int(result.converged), result.iterations)

    @classmethod
    def joined(cls, parts: Iterable[Convergence]) -> Convergence:
        """Return how several ended."""
        found = list(parts)
        return cls(
            sum(part.parts for part in found),
            sum(part.converged for part in found),
            max(part.iterations for part in found),
        )

    @property
    def status(self) -> str:
        """One sentence for people."""
        if self.converged == self.parts:
            return f"Converged: the cost no longer changes after {self.iterations} linearisations."
        where = "" if self.parts == 1 else f" in {self.parts - self.converged} of {self.parts} parts of the take"
        return f"Stopped after {self.iterations} linearisations{where}; more iterations may help."


@dataclass(frozen=True)
class SolvedFrames:
    """Poses of a take, and what the method knows of them."""

    subject: Subject
    """The person, with the shape and bias of the last pass."""
    frames: PosedFrames
    """F poses."""
    key_times: np.ndarray = field(default_factory=lambda: np.arange(0))
    """Frame numbers of the keyframes; they may fall between frames."""
    covariance: Array | None = None
    """(F, 24, 6) covariance of each joint in square metres (see ``packed``), where the method knows it."""
    contacts: np.ndarray | None = None
    """(F, 2) bool: left and right foot stand, where the method knows it."""
    fitted: PosedFrames | None = None
    """The poses before parts of the body came to rest, which explain what was measured; None where none did."""
    resting: np.ndarray | None = None
    """(F, J) bool: nothing measured informs the joint, which is at rest; None: all are informed."""
    diagnostics: tuple[Diagnostic, ...] = ()
    """What the motion is to report of these poses."""


MethodResult = tuple[SolvedFrames, Convergence]
"""What a method returns."""
