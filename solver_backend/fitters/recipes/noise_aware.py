"""The noise-aware method: landmarks whose reliability is estimated with the pose, frame by frame (thesis chapter 5)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import Stretches
from solver_backend.fitters.model.frame_states import FrameStates
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.noise_aware.landmark_fit import BLOCK_FRAMES, CodedFrames, FitWeights, LandmarkFit
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.fit import bridged_states, posed
from solver_backend.fitters.single_frame.start import fit_to_points, sample_frames
from solver_backend.fitters.solution import Convergence, MethodResult, SolvedFrames
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.sphere import spherical_normalisation
from solver_backend.priors.gaussian_vae import GaussianVAE, load_vae
from solver_backend.residuals.landmark_loss import FixedVariances, LandmarkLoss, LearnedVariances
from solver_backend.solver.independent_lbfgs import QuasiNewtonSettings

SHAPE_FRAMES = 12
"""Frames that the shape is found from, as in MoSh++ (Mahmood et al. 2019)."""
STEPS = QuasiNewtonSettings()
"""Of both stages."""


@cache
def pose_prior() -> GaussianVAE:
    """Return RVPoser (thesis 4.2.4), whose codes are the method's z."""
    return load_vae("rvposer")


def solve_noise_aware(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, each: Stretches
) -> MethodResult:
    """Minimise thesis eq. 5.8 in its two stages (thesis 5.2.3); unseen frames are bridged between their neighbours.

    Shape, poses and translations come first, with fixed variances: the shape from ``SHAPE_FRAMES`` frames, as a take
    has one; then, with the shape held, poses, translations and each landmark's log-variance in each frame.
    """
    return solve_in_stages(problem, subject, settings, progress, LearnedVariances())


def solve_in_stages(
    problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress, loss: LandmarkLoss
) -> MethodResult:  # fmt: skip
    """Fit shape and poses by least squares, then poses by a loss.

    Args:
        problem: the measurements; their located points are used, and nothing of their noise.
        subject: whose shape is found, if neither the settings nor a subject file know it.
        settings: method and the rest.
        progress: called as stages advance.
        loss: of the second stage.
    """
    like, measured = subject.betas, problem.measurements
    person = replace(subject, betas=to_numpy(subject.betas), offsets=to_numpy(subject.offsets))
    prior, seen = pose_prior(), np.flatnonzero(measured.seen)
    progress("Noise-aware fit", 0, 3)

    def fit_of(person: Subject, frames: np.ndarray) -> LandmarkFit:
        states = fit_to_points(problem, person, frames)
        start = CodedFrames(prior.encode(posed(problem.prior, states).local), states.root, states.transl)
        located = measured.located[frames]
        points = np.where(located[..., None], measured.points[frames], 0.0)
        return LandmarkFit(person, prior, start, points, located, FitWeights())

    if settings.betas is None and measured.subject is None:
        person, _ = fit_of(person, sample_frames(measured, SHAPE_FRAMES)).fit_shape(FixedVariances(), STEPS)
    progress("Noise-aware fit", 1, 3)
    found, ends = [], []
    blocks = [seen[i : i + BLOCK_FRAMES] for i in range(0, len(seen), BLOCK_FRAMES)]
    for number, block in enumerate(blocks):
        fit = fit_of(person, block)
        coarse, _ = fit.fit_poses(FixedVariances(), STEPS)
        fine, end = replace(fit, start=coarse).fit_poses(loss, STEPS)
        found.append(fine)
        ends.append(Convergence(len(block), int(end.converged.sum()), end.iterations))
        progress("Noise-aware fit", len(blocks) + 2 * (number + 1), 3 * len(blocks))
    frames = _bridged(found, seen, problem.num_frames).posed(prior)
    solved = SolvedFrames(replace(subject, betas=constant(person.betas, like)), _like(frames, like))
    return solved, Convergence.joined(ends)


def _bridged(parts: list[CodedFrames], seen: np.ndarray, num_frames: int) -> CodedFrames:
    """Return states of all frames: unseen ones between their seen neighbours, codes on straight lines."""
    z, root, transl = (np.concatenate([getattr(part, name) for part in parts]) for name in ("z", "root", "transl"))
    between = bridged_states(FrameStates(spherical_normalisation(z), root, transl), seen, num_frames)
    frame = np.arange(num_frames)
    codes = np.stack([np.interp(frame, seen, column) for column in z.T], axis=1)
    return CodedFrames(codes, between.root, between.transl)


def _like(frames: PosedFrames, like: Array) -> PosedFrames:
    return PosedFrames(*(constant(part, like) for part in (frames.root, frames.local, frames.transl)))
