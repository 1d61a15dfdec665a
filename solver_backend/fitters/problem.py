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

REFERENCE_FPS = 60.0  # Settings count windows in frames of this rate, because people move independently of the camera.
SAMPLE_FRAMES = 200  # Largest number of frames from which shape, bias and noise are learned between passes.


@dataclass(frozen=True)
class Problem:
    """Measurements prepared for a solver."""

    body: Body
    prior: AutoencodingPrior
    measurements: Measurements
    pose_terms: tuple[PoseTerm, ...]  # Further terms that evaluate poses.

    @classmethod
    def of(cls, body: Body, prior: AutoencodingPrior, measurements: Measurements) -> Problem:
        """Return the problem with the prior on the body's joints, and the shipped mixture of poses.

        Raises:
            PriorInvalid: the prior contradicts itself or the body.
        """
        fitting = prior_on_body(prior, body.layout)
        return cls(body, fitting, measurements, (PoseMixtureTerm.of(fitting.joints),))

    @property
    def objective(self) -> FrameObjective:
        """The objective of all single frames: the data and the pose terms."""
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
        """Return the number of frames of this take as long as ``window`` frames at 60 fps."""
        return max(least, round(window * self.fps / REFERENCE_FPS))


@dataclass(frozen=True)
class Solution:
    """A solved take."""

    motion: Motion
    status: str
    """One sentence on how the last pass ended, also in the motion's provenance."""


@dataclass(frozen=True)
class Convergence:
    """End of the last robust scale of a solve, over parts solved one after the other."""

    parts: int
    converged: int  # Parts with a stable cost.
    iterations: int  # Largest number of linearisations of a part.

    @classmethod
    def of(cls, result: LMResult[Any]) -> Convergence:
        """Return the end of one minimisation."""
        return cls(1, int(result.converged), result.iterations)

    @classmethod
    def joined(cls, parts: Iterable[Convergence]) -> Convergence:
        """Return the end of several."""
        found = list(parts)
        converged = sum(part.converged for part in found)
        return cls(sum(part.parts for part in found), converged, max(part.iterations for part in found))

    @property
    def status(self) -> str:
        """One sentence for people."""
        if self.converged == self.parts:
            return f"Converged: the cost no longer changes after {self.iterations} linearisations."
        where = "" if self.parts == 1 else f" in {self.parts - self.converged} of {self.parts} parts of the take"
        return f"Stopped after {self.iterations} linearisations{where}; more iterations may help."


@dataclass(frozen=True)
class SolvedFrames:
    """Poses of a take, and what the method estimated with them."""

    subject: Subject  # With the shape and bias of the last pass.
    frames: PosedFrames
    key_times: np.ndarray = field(default_factory=lambda: np.arange(0))
    """Frame numbers of the keyframes; they may fall between frames."""
    covariance: Array | None = None
    """(F, 24, 6) covariance of each joint in square metres (see ``packed``), if the method estimates it."""
    contacts: np.ndarray | None = None  # (F, 2) bool: left and right foot stand, if the method detects it.
    fitted: PosedFrames | None = None
    """Poses before parts of the body came to rest, which fit the measurements; None if no part did."""
    resting: np.ndarray | None = None
    """(F, J) bool: no measurement informs the joint, which is at rest; None if all are informed."""
    diagnostics: tuple[Diagnostic, ...] = ()  # Diagnostics of these poses for the motion.


MethodResult = tuple[SolvedFrames, Convergence]  # What a method returns.
