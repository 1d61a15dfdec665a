"""A frame range of a motion solved again: its body, then the fingers that something shows, put into the motion."""

from __future__ import annotations

from solver_backend.exchange.progress import Progress
from solver_backend.fitters.hands.wide_motion import with_fingers_of, without_fingers
from solver_backend.fitters.keyframes.frame_range import FrameRange
from solver_backend.fitters.keyframes.splice_range import spliced
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.recipes.frame_range import solve_range
from solver_backend.fitters.settings import SolveSettings
from solver_backend.fitters.solution import Solution
from solver_backend.types import Motion


def solve_again(
    problem: Problem, subject: Subject, motion: Motion, frame_range: FrameRange, settings: SolveSettings,
    progress: Progress,
) -> Solution:  # fmt: skip
    """Return the motion with a frame range solved again; all other frames stay as they are, bit for bit.

    Args:
        problem: the measurements made ready.
        subject: the person; shape and bias are taken from the motion.
        motion: the earlier solve, with or without fingers.
        frame_range: what to solve again, and the pins.
        settings: as of the earlier solve.
        progress: called as stages advance.

    Raises:
        JobInvalid: the take does not have the frame range.
        MotionInvalid: the motion belongs to another take or body.
    """
    from solver_backend.fitters.hands.hand_range import solve_hands_again

    body = without_fingers(motion)
    solved, frames = solve_range(problem, subject, body, frame_range, settings, progress)
    frames, hands = solve_hands_again(problem.measurements, frames, motion, frame_range, settings, progress)
    again = spliced(problem, body, solved, frames, settings.robust_scale)
    return Solution(with_fingers_of(again, motion, solved, hands, problem.body), solved.status)
