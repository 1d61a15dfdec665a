"""The person, learned from a sample of frames before the take is solved."""

from __future__ import annotations

from dataclasses import replace

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.fit import fit_frames
from solver_backend.fitters.single_frame.start import fit_to_points, lifted_betas, sample_frames
from solver_backend.fitters.subject_calibration.shape import ShapePrior, fit_shape
from solver_backend.residuals.robust import graduated_scales
from solver_backend.solver.levenberg_marquardt import LMSettings

SAMPLE_FRAMES = 32
"""Frames from which the shape is learned."""


def learn_subject(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> Subject:
    """Return the subject with the shape learned from a sample of frames, where the settings know none.

    A person who is known before the solve stays as they are.
    """
    if problem.measurements.subject is not None:
        return problem.measurements.subject
    frames = sample_frames(problem.measurements, SAMPLE_FRAMES)
    progress("Learning the body", 0, 3)
    if settings.betas is None:
        subject = replace(subject, betas=lifted_betas(subject, problem.measurements, frames))
    states = fit_to_points(problem, subject, frames)
    progress("Learning the body", 1, 3)
    objective, steps = problem.objective.select(frames), LMSettings(settings.iterations)
    states = fit_frames(subject, problem.prior, objective, states, (4 * settings.robust_scale,), steps).state
    progress("Learning the body", 2, 3)
    scales = graduated_scales(settings.robust_scale, 3 * settings.robust_scale, 2)
    shape_prior = ShapePrior(free_betas=settings.betas is None, free_offsets=False)
    subject, _ = fit_shape(subject, problem.prior, objective, states, scales, steps, shape_prior)
    progress("Learning the body", 3, 3)
    return subject
