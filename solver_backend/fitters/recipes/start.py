"""Where the passes over a whole take begin: keys spread evenly over it, in the windows that the settings ask for."""

from __future__ import annotations

from functools import partial

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.keyframes.chunked import Stretches, solve_in_single
from solver_backend.fitters.keyframes.initial_keys import initial_keys, keys_of_frames
from solver_backend.fitters.keyframes.optimise import Schedule
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.bundle import Bundle
from solver_backend.fitters.settings import SolveSettings


def start_take(
    problem: Problem, subject: Subject, settings: SolveSettings, schedule: Schedule, each: Stretches,
    progress: Progress,
) -> Bundle:  # fmt: skip
    """Return the bundle before its first pass.

    Args:
        problem: the take.
        subject: what does not change over it.
        settings: of the solve.
        schedule: of the first pass.
        each: how stretches of a long take are solved.
        progress: called as frames are fitted.
    """
    window = problem.frames_of(settings.refine_window)
    layout = KeyframeLayout.even(problem.num_frames, window)
    keys = initial_keys(problem, subject, layout, progress)
    return Bundle.start(
        problem, subject, settings, layout, window, keys, schedule, partial(solve_in_single, each=each),
        keys_of_frames(problem, subject, layout, keys),
    )  # fmt: skip
