"""Levenberg-Marquardt over takes of any length: stretches of frames, each held by the last frame of the one before."""

from __future__ import annotations

from dataclasses import replace

from array_api_compat import array_namespace

from solver_backend.exchange.progress import Progress, silent
from solver_backend.fitters.model.subject import PosedFrames, pose, select_frames
from solver_backend.fitters.pose_ndf.sequence_equations import PoseChain
from solver_backend.geometry.arrays import Array
from solver_backend.solver.levenberg_marquardt import LMSettings, levenberg_marquardt

STRETCH = 240
"""Frames solved at once, as the paper's longest sequences."""


def solve_chain(
    chain: PoseChain, start: PosedFrames, iterations: int, stage: str = "Fitting", progress: Progress = silent
) -> tuple[PosedFrames, Array]:
    """Return the poses that minimise the chain's cost, and the cost (1,) summed over the stretches.

    Args:
        chain: all frames of the take.
        start: where to start.
        iterations: linearisations at most for each stretch.
        stage: what the work is called to the user.
        progress: called after every stretch.
    """
    xp = array_namespace(start.transl)
    count = start.transl.shape[0]
    parts: list[PosedFrames] = []
    total, before = 0.0, chain.before
    for first in range(0, count, STRETCH):
        frames = slice(first, min(first + STRETCH, count))
        part = replace(chain, observed=chain.observed[frames], seen=chain.seen[frames], before=before)
        found = levenberg_marquardt(
            select_frames(start, frames), part.linearise, part.retract, lambda _, new, old: new,
            LMSettings(max_iterations=iterations, tolerance=1e-5),
        )  # fmt: skip
        parts.append(found.state)
        total = total + found.cost
        before = pose(chain.subject, select_frames(found.state, slice(-1, None))).points[0]
        progress(stage, frames.stop, count)
    joined = (xp.concat([getattr(p, name) for p in parts]) for name in ("root", "local", "transl"))
    return PosedFrames(*joined), total
