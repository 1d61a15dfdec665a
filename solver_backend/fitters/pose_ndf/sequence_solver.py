"""Levenberg-Marquardt over takes of any length: chunks of frames, each joined to the last frame of the one before."""

from __future__ import annotations

from dataclasses import replace

from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import pose
from solver_backend.fitters.pose_ndf.sequence_equations import PoseSequence
from solver_backend.geometry.arrays import Array
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt

CHUNK_FRAMES = 240
"""Frames solved at once, as the paper's longest sequences."""


def solve_sequence(
    sequence: PoseSequence, start: PosedFrames, iterations: int, stage: str = "Fitting", progress: Progress = silent
) -> tuple[PosedFrames, Array]:
    """Return the poses that minimise the sequence's cost, and the cost (1,) summed over the chunks.

    Args:
        sequence: all frames of the take.
        start: where to start.
        iterations: linearisations at most for each chunk.
        stage: what the work is called to the user.
        progress: called after every chunk.
    """
    count = start.transl.shape[0]
    parts: list[PosedFrames] = []
    total, before = 0.0, sequence.before
    for first in range(0, count, CHUNK_FRAMES):
        frames = slice(first, min(first + CHUNK_FRAMES, count))
        part = replace(sequence, observed=sequence.observed[frames], seen=sequence.seen[frames], before=before)
        found = levenberg_marquardt(
            start.select(frames), part.linearise, part.retract,
            LMSettings(max_iterations=iterations, tolerance=1e-5),
        )  # fmt: skip
        parts.append(found.state)
        total = total + found.cost
        before = pose(sequence.subject, found.state.select(slice(-1, None))).points[0]
        progress(stage, frames.stop, count)
    return PosedFrames.concatenate(parts), total
