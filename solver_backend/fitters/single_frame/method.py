"""The frame method: every frame on its own (thesis eq. 6.5)."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.single_frame.fit import bridged_states, fit_frames, posed
from solver_backend.fitters.single_frame.start import fit_to_points
from solver_backend.residuals.robust import graduated_scales


def solve_by_frame(problem: Problem, subject: Subject, settings: SolveSettings, progress: Progress) -> PosedFrames:
    """Fit every seen frame on its own; unseen frames are bridged between their neighbours."""
    seen = np.flatnonzero(problem.observations.seen)
    states = fit_to_points(subject, problem.prior, problem.observations, seen)
    scales = graduated_scales(settings.robust_scale, 4 * settings.robust_scale, 3)
    states, _ = fit_frames(
        subject, problem.prior, problem.term.select(seen), states, scales, settings.iterations, progress
    )  # fmt: skip
    return posed(problem.prior, bridged_states(states, seen, problem.num_frames))
