"""A capture made ready for a solver, and the person in it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from solver_backend.body.body import Body
from solver_backend.exchange.progress import Progress
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.fit import fit_frames
from solver_backend.fitters.single_frame.start import Observations, fit_to_points, lifted_betas, sample_frames
from solver_backend.fitters.subject_calibration.shape import fit_shape
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.residuals.robust import graduated_scales
from solver_backend.types import Capture, Fault

REFERENCE_FPS = 60.0
"""Windows of the settings are counted in frames of this rate: how fast people move does not depend on the camera."""
SAMPLE_FRAMES = 32
"""Frames from which shape and detector bias are learned."""


@dataclass(frozen=True)
class Problem:
    """A capture made ready for a solver."""

    body: Body
    """The body model."""
    prior: AutoencodingPrior
    """Decoder of poses."""
    observations: Observations
    """Triangulated points and the detector's noise."""
    term: ReprojectionTerm
    """Data of all frames."""
    fps: float
    """Frames per second."""
    num_frames: int
    """F."""
    capture: Capture
    """What is solved: the recording with the faults of its views put right."""
    faults: tuple[Fault, ...] = ()
    """Those faults."""

    def frames_of(self, window: int, least: int = 2) -> int:
        """Return how many frames of this take last as long as ``window`` frames at 60 a second."""
        return max(least, round(window * self.fps / REFERENCE_FPS))


def learn_subject(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> Subject:
    """Return the subject with shape and detector bias learned from a sample of frames."""
    frames = sample_frames(problem.observations, SAMPLE_FRAMES)
    progress("Learning the body", 0, 3)
    if settings.betas is None:
        subject = replace(subject, betas=lifted_betas(subject, problem.observations, frames))
    states = fit_to_points(subject, problem.prior, problem.observations, frames)
    progress("Learning the body", 1, 3)
    term = problem.term.select(frames)
    states, _ = fit_frames(subject, problem.prior, term, states, (4 * settings.robust_scale,), settings.iterations)
    progress("Learning the body", 2, 3)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    free = settings.betas is None
    subject, _ = fit_shape(
        subject, problem.prior, term, states, scales, settings.iterations, free_betas=free, free_offsets=False
    )
    progress("Learning the body", 3, 3)
    return subject
